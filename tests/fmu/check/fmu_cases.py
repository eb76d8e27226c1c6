"""Small FMUs, correct but unusual or with one violation, as files by name in the archive."""

from collections.abc import Mapping
from textwrap import dedent

from fmu_files import MODEL

DESCRIPTION_2 = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Unusual" guid="any text"{attributes}>
  {kinds}
  {head}
  <ModelVariables>{variables}</ModelVariables>
  <ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>
"""
KIND_2 = """<CoSimulation modelIdentifier="u"{flags}>
  <SourceFiles><File name="u.c"/></SourceFiles></CoSimulation>"""
OUTPUT_2 = """<ScalarVariable name="y" valueReference="0" causality="output"><Real{unit}/>
  </ScalarVariable>"""
OUTPUTS_2 = """<Outputs><Unknown index="1" dependencies=""/></Outputs>
  <InitialUnknowns><Unknown index="1" dependencies=""/></InitialUnknowns>"""

DESCRIPTION_3 = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="Unusual" instantiationToken="any text"
    {attributes}>
  {kinds}
  {head}
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    {variables}
  </ModelVariables>
  <ModelStructure>{structure}</ModelStructure>
  {tail}
</fmiModelDescription>
"""
BUILD_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="u"><SourceFileSet>
<SourceFile name="u.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""


def build_fmi_2(
    *,
    attributes: str = "",
    kinds: str = "",
    flags: str = "",
    head: str = "",
    variables: str = OUTPUT_2.format(unit=""),
    structure: str = OUTPUTS_2,
    files: Mapping[str, bytes] | None = None,
) -> dict[str, bytes]:
    """Return the files of an FMU of FMI 2.0 as source code."""
    text = DESCRIPTION_2.format(
        attributes=attributes,
        kinds=kinds or KIND_2.format(flags=flags),
        head=head,
        variables=variables,
        structure=structure,
    )
    return {MODEL: dedent(text).encode(), "sources/u.c": b"", **(files or {})}


def build_fmi_3(
    *,
    version: str = "3.0",
    attributes: str = "",
    kinds: str = '<CoSimulation modelIdentifier="u"/>',
    head: str = "",
    variables: str = "",
    structure: str = "",
    tail: str = "",
    files: Mapping[str, bytes] | None = None,
) -> dict[str, bytes]:
    """Return the files of an FMU of FMI 3.0 as source code."""
    text = DESCRIPTION_3.format(
        version=version,
        attributes=attributes,
        kinds=kinds,
        head=head,
        variables=variables,
        structure=structure,
        tail=tail,
    )
    sources = {"sources/u.c": b"", "sources/buildDescription.xml": BUILD_3}
    return {MODEL: text.encode(), **sources, **(files or {})}


def define_real(name: str, number: int, attributes: str = "", real: str = "") -> str:
    """Return a variable of FMI 2.0."""
    return (
        f'<ScalarVariable name="{name}" valueReference="{number}" {attributes}><Real {real}/>'
        "</ScalarVariable>"
    )


PARAMETER = 'causality="parameter" variability="fixed"'
TUNABLE = 'causality="parameter" variability="tunable"'

UNITS_2 = """<UnitDefinitions>
  <Unit name="°C"><BaseUnit K="1" offset="273.15"/><DisplayUnit name="°F" factor="1.8"
    offset="32"/><DisplayUnit name="K" offset="273.15"/></Unit>
  <Unit name="%"><BaseUnit factor="0.01"/></Unit>
  <Unit name="µm/√s"/>
  <Unit name="1/min"><BaseUnit s="-1" rad="1" factor="0.10471975511965977"/></Unit>
</UnitDefinitions>"""
RADIAN = '<UnitDefinitions><Unit name="rad"/></UnitDefinitions>'
TYPES_2 = """<TypeDefinitions>
  <SimpleType name="Modelica.Units.SI.Angle" description="&lt;b&gt;"><Real quantity="Angle"
    unit="rad" relativeQuantity="true" min="-INF" max="INF" nominal="1e-300"
    unbounded="true"/></SimpleType>
  <SimpleType name="Empty"><String/></SimpleType>
  <SimpleType name="Bits"><Integer min="-2147483648" max="2147483647"/></SimpleType>
  <SimpleType name="Gear"><Enumeration><Item name="reverse" value="-1"/><Item name="neutral"
    value="0" description=""/><Item name="1. Gang" value="1"/></Enumeration></SimpleType>
</TypeDefinitions>"""
TYPED_2 = f"""
<ScalarVariable name="y" valueReference="0" causality="output" variability="discrete">
  <Enumeration declaredType="Gear"/></ScalarVariable>
<ScalarVariable name="gear" valueReference="1" {PARAMETER}>
  <Enumeration declaredType="Gear" start="-1"/></ScalarVariable>
<ScalarVariable name="bits" valueReference="2" {TUNABLE}>
  <Integer declaredType="Bits" start="-2147483648"/></ScalarVariable>
<ScalarVariable name="text" valueReference="3" {PARAMETER}>
  <String declaredType="Empty" start=""/></ScalarVariable>
<ScalarVariable name="flag" valueReference="4" {PARAMETER}><Boolean start="1"/></ScalarVariable>
{define_real("angle", 5, PARAMETER, 'declaredType="Modelica.Units.SI.Angle" start="-.5e-1"')}"""

STATES_2 = f"""
{define_real("h", 1, 'initial="exact"', 'start="1" reinit="true"')}
{define_real("der(h)", 2, "", 'derivative="1"')}
{define_real("der(h,2)", 3, 'causality="output"', 'derivative="2"')}
{define_real("g", 4, 'variability="constant"', 'start="9.8"')}
{define_real("k", 5, 'causality="calculatedParameter" variability="fixed"')}
{define_real("u", 6, 'causality="input"', 'start="0"')}
{define_real("time", 7, 'causality="independent"')}"""
STATES_STRUCTURE_2 = """
<Outputs><Unknown index="3" dependencies="1 6" dependenciesKind="dependent constant"/></Outputs>
<Derivatives><Unknown index="2" dependencies=""/>
  <Unknown index="3" dependencies="1 6" dependenciesKind="tunable discrete"/></Derivatives>
<InitialUnknowns><Unknown index="2"/><Unknown index="3"/><Unknown index="5"/></InitialUnknowns>"""
BOTH_2 = """<ModelExchange modelIdentifier="u" needsExecutionTool="false"
  completedIntegratorStepNotNeeded="true"><SourceFiles><File name="./u.c"/></SourceFiles>
  </ModelExchange><CoSimulation modelIdentifier="u_cs" canHandleVariableCommunicationStepSize="1"
  maxOutputDerivativeOrder="3"><SourceFiles><File name="u.c"/><File name="cs/v.cpp"/></SourceFiles>
  </CoSimulation>"""

ALIASES_2 = f"""
{define_real("y", 0, 'causality="output"', 'unit="N" displayUnit="kN"')}
{define_real("z.&quot;", 0, "", 'unit="N"')}
{define_real("one", 7, 'variability="constant"', 'start="1"')}
{define_real("another one", 7, 'variability="constant"', 'start="1"')}"""
NEWTON = """<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/>
  <DisplayUnit name="kN" factor="0.001"/></Unit></UnitDefinitions>"""

CATEGORIES_2 = """<LogCategories><Category name="logAll" description="ü"/>
  <Category name="my own category"/></LogCategories>"""
VENDORS_2 = """<VendorAnnotations><Tool name="a.b"><x:anything xmlns:x="urn:x" startt="1">
  <Unit name="1"/></x:anything></Tool><Tool name="c"><deep><er/></deep></Tool>
  </VendorAnnotations>"""
ANNOTATED_2 = """<ScalarVariable name="y" valueReference="4294967295" causality="output"
  canHandleMultipleSetPerTimeInstant="true"><Real/><Annotations><Tool name="t"><box x="1"/></Tool>
  </Annotations></ScalarVariable>"""
TEXTS_2 = f"""
<ScalarVariable name="y" valueReference="1" causality="output" variability="discrete">
  <String/></ScalarVariable>
<ScalarVariable name="lines" valueReference="2" {PARAMETER}
  description="two lines:&#10;&#9;a &lt; b &amp; c"><String start="a&#10;b  c"/></ScalarVariable>
<ScalarVariable name="version" valueReference="3" causality="output" variability="constant"
  initial="exact"><String start="1.0 β"/></ScalarVariable>"""
TEXTS_STRUCTURE_2 = """<Outputs><Unknown index="1"/><Unknown index="3"/></Outputs>
  <InitialUnknowns><Unknown index="1"/></InitialUnknowns>"""
QUOTED_2 = define_real("a.'b c\\'d'.e_1[10,2]", 0, 'causality="output"')
DECLARED_2 = (
    "<?xml version='1.0' encoding='utf-8' standalone='yes'?>\r\n<!-- a -->\r\n<?tool data?>\r\n"
)


def rewrite(files: Mapping[str, bytes], head: str) -> dict[str, bytes]:
    """Return files with another first line of the description, and line ends of Windows."""
    body = files[MODEL].partition(b"\n")[2].replace(b"\n", b"\r\n")
    return {**files, MODEL: head.encode() + body}


ARRAYS_3 = """
<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="tunable"
  start="3" min="1"/>
<Float64 name="A" valueReference="2" causality="parameter" variability="tunable"
  start="1 2 3  4 5 6"><Dimension start="2"/><Dimension valueReference="1"/></Float64>
<Float32 name="same" valueReference="3" causality="input" start="0.5"><Dimension start="4"/>
  </Float32>
<Boolean name="flags" valueReference="4" causality="parameter" variability="fixed"
  start="true false 1"><Dimension valueReference="1"/></Boolean>
<Float64 name="y" valueReference="5" causality="output" initial="calculated"><Dimension
  valueReference="1"/></Float64>
<String name="names" valueReference="6" causality="parameter" variability="fixed"><Dimension
  start="2"/><Start value=""/><Start value="two words"/></String>"""
Y_3 = """<Output valueReference="5"/><InitialUnknown valueReference="5"/>"""

INTEGERS_3 = "".join(
    f'<{kind} name="{kind}" valueReference="{number}" causality="parameter" variability="fixed"'
    f' min="{low}" max="{high}" start="{start}"/>'
    for number, (kind, low, high, start) in enumerate(
        [
            ("Int8", -128, 127, -128),
            ("UInt8", 0, 255, 255),
            ("Int16", -32768, 32767, -32768),
            ("UInt16", 0, 65535, 65535),
            ("Int32", -(2**31), 2**31 - 1, -(2**31)),
            ("UInt32", 0, 2**32 - 1, 2**32 - 1),
            ("Int64", -(2**63), 2**63 - 1, -(2**63)),
            ("UInt64", 0, 2**64 - 1, 2**64 - 1),
        ],
        start=1,
    )
)
BINARIES_3 = """
<Binary name="image" valueReference="1" causality="input" mimeType="image/png" maxSize="100000">
  <Start value="89504e470D0A"/></Binary>
<Binary name="none" valueReference="2" causality="output" variability="discrete"/>
<Binary name="two" valueReference="3" causality="parameter" variability="fixed"><Dimension
  start="2"/><Start value=""/><Start value="00"/></Binary>"""
BINARIES_STRUCTURE_3 = """<Output valueReference="2"/><InitialUnknown valueReference="2"/>"""
CLOCKS_3 = """
<Clock name="periodic" valueReference="1" causality="input" intervalVariability="constant"
  intervalDecimal="0.01" shiftDecimal="0.002" priority="1"/>
<Clock name="counted" valueReference="2" causality="input" intervalVariability="fixed"
  intervalCounter="1" resolution="1000" supportsFraction="true" priority="2"/>
<Clock name="triggered" valueReference="3" causality="output" intervalVariability="triggered"/>
<Clock name="countdown" valueReference="4" causality="input" intervalVariability="countdown"
  canBeDeactivated="true" priority="3"/>
<Float64 name="in" valueReference="5" causality="input" variability="discrete" clocks="1 2"
  start="0"/>
<Float64 name="state" valueReference="6" causality="local" variability="discrete"
  initial="calculated" clocks="1" previous="7"/>
<Float64 name="last" valueReference="7" causality="local" variability="discrete" initial="exact"
  start="0" clocks="1"/>
<Int32 name="out" valueReference="8" causality="output" clocks="3"/>"""
CLOCKS_STRUCTURE_3 = """<Output valueReference="3"/><Output valueReference="8"/>
  <ClockedState valueReference="6"/>"""
SCHEDULED_3 = """<ScheduledExecution modelIdentifier="u" needsExecutionTool="0"
  canBeInstantiatedOnlyOncePerProcess="true" providesDirectionalDerivatives="true"/>"""
ALL_KINDS_3 = """<ModelExchange modelIdentifier="u" needsCompletedIntegratorStep="false"
  providesEvaluateDiscreteStates="true"/><CoSimulation modelIdentifier="u"
  fixedInternalStepSize="0.001" canReturnEarlyAfterIntermediateUpdate="true" hasEventMode="true"
  mightReturnEarlyFromDoStep="true" recommendedIntermediateInputSmoothness="-1"
  providesIntermediateUpdate="true" maxOutputDerivativeOrder="2" canGetAndSetFMUState="true"
  canSerializeFMUState="true"/><ScheduledExecution modelIdentifier="u"/>"""
UNITS_3 = """<UnitDefinitions><Unit name="Ω"><BaseUnit kg="1" m="2" s="-3" A="-2"/><DisplayUnit
  name="S" inverse="true"/></Unit><Unit name="K"><BaseUnit K="1"/><DisplayUnit name="°C"
  offset="-273.15"/><Annotations><Annotation type="org.x">text</Annotation></Annotations></Unit>
  </UnitDefinitions>"""
TYPES_3 = """<TypeDefinitions>
<Float64Type name="T1" unit="K" displayUnit="°C" min="0" nominal="300" quantity="q"/>
<Int64Type name="T2" min="-9223372036854775808"/><BooleanType name="T3"/><StringType name="T4"/>
<BinaryType name="T5"/>
<EnumerationType name="T7"><Item name="on" value="9223372036854775807"/><Item name="off"
  value="-9223372036854775808" description="d"/></EnumerationType></TypeDefinitions>"""
TYPED_3 = """
<Float64 name="T" valueReference="1" causality="input" declaredType="T1" start="273.15"/>
<Enumeration name="switch" valueReference="2" causality="parameter" variability="fixed"
  declaredType="T7" start="9223372036854775807"/>
<Enumeration name="switches" valueReference="3" causality="parameter" variability="fixed"
  declaredType="T7" start="-9223372036854775808 9223372036854775807"><Dimension start="2"/>
  </Enumeration>
<Float64 name="r" valueReference="5" causality="output" unit="Ω" initial="calculated">
  <Alias name="r in S" displayUnit="S" description="conductance"/></Float64>"""
STATES_3 = """
<Float64 name="x" valueReference="10" initial="exact" start="1 2" reinit="true"><Dimension
  start="2"/></Float64>
<Float64 name="der(x)" valueReference="3" derivative="10" initial="calculated"><Dimension
  start="2"/></Float64>
<Float64 name="z" valueReference="5" causality="output" initial="calculated"/>
<Float64 name="event" valueReference="2" initial="calculated"/>
<Float64 name="u" valueReference="1" causality="input" intermediateUpdate="true" start="0"/>"""
STATES_STRUCTURE_3 = """<Output valueReference="5" dependencies="10 1 3"
  dependenciesKind="dependent fixed constant"/>
  <ContinuousStateDerivative valueReference="3" dependencies=""/>
  <InitialUnknown valueReference="5" dependencies="10"/><InitialUnknown valueReference="3"/>
  <EventIndicator valueReference="2" dependencies="10"/>"""
EXCHANGE_3 = '<ModelExchange modelIdentifier="u"/>'

CLOCK_TYPE = """<TypeDefinitions><ClockType name="T" intervalVariability="triggered"/>
  </TypeDefinitions>"""
TYPED_CLOCK = """<Clock name="c" valueReference="1" causality="input" declaredType="T"
  intervalVariability="triggered"/>"""
BINARY_TYPE = """<TypeDefinitions><BinaryType name="T" mimeType="a/b" maxSize="9"/>
  </TypeDefinitions>"""

ICON = "terminalsAndIcons/terminalsAndIcons.xml"
TERMINALS_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0"><GraphicalRepresentation><CoordinateSystem
  suggestedScalingFactorTo_mm="0.1" x1="-100"
  y1="-100" x2="100" y2="100"/><Icon x1="-1" y1="-1" x2="1" y2="1"/></GraphicalRepresentation>
  <Terminals><Terminal name="pin" matchingRule="bus"
  terminalKind="org.x" description="d"><TerminalMemberVariable variableName="r" memberName="r"
  variableKind="signal"/><Terminal name="inner" matchingRule="none"><TerminalMemberVariable
  variableName="r in S" variableKind="local"/><TerminalGraphicalRepresentation x1="0" y1="0" x2="1"
  y2="1" iconBaseName="pin"/></Terminal></Terminal><Terminal name="inner" matchingRule="plug"/>
  </Terminals></fmiTerminalsAndIcons>
"""
ICONS = {ICON: TERMINALS_3, "terminalsAndIcons/icon.png": b"", "terminalsAndIcons/icon.svg": b""}
BUILD_SETS_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="u" platform="x86-linux"
  description="fast"><SourceFileSet language="C99" compiler="gcc" compilerOptions="-O2"><SourceFile
  name="u.c"/><PreprocessorDefinition name="A" value="1" optional="true"><Option value="1"/>
  </PreprocessorDefinition><IncludeDirectory name="../resources/include"/></SourceFileSet>
  <SourceFileSet language="C++11"><SourceFile name="more/v.cpp"/></SourceFileSet><Library name="m"
  external="true"/></BuildConfiguration><BuildConfiguration modelIdentifier="u"><SourceFileSet
  name="all"><SourceFile name="u.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""
ANNOTATED_3 = """<Annotations><Annotation type="org.x"><a:b xmlns:a="urn:a" causality="?"/>
  </Annotation><Annotation type="plain text">text</Annotation></Annotations>"""
MANIFEST = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
  fmi-ls:fmi-ls-name="org.x" fmi-ls:fmi-ls-version="1.0" fmi-ls:fmi-ls-description=""/>
"""
EXTRA_FILES = {
    "documentation/index.html": b"<html></html>",
    "documentation/licenses/license.spdx": b"MIT",
    "documentation/diagram.svg": b"<svg/>",
    "resources/": b"",
    "resources/a b/äö (1).tar.gz": b"\x00\x01",
    "resources/empty/.keep": b"",
    "extra/org.x/fmi-ls-manifest.xml": MANIFEST,
    "extra/com.y/anything.xml": b"no XML",
    "binaries/riscv64-linux/u.so": b"not looked at",
    "sources/u.c": b'#include <stdio.h>\n#include "inner/a.h"\n',
    "sources/inner/a.h": b"#pragma once\n",
    "README": b"",
}

SIZED_3 = """
<UInt64 name="k" valueReference="9" variability="constant" start="3"/>
<Float64 name="v" valueReference="4" causality="parameter" variability="fixed" start="1 2 3">
  <Dimension valueReference="9"/></Float64>"""
SLOPE_3 = """
<Float64 name="u" valueReference="1" causality="input" start="0"/>
<Float64 name="du" valueReference="2" causality="input" start="0" derivative="1"/>
<Float64 name="y" valueReference="3" causality="output" initial="exact" start="0"/>
<Float64 name="dy" valueReference="4" causality="output" initial="exact" start="0"
  derivative="3"/>"""
SLOPE_STRUCTURE_3 = """<Output valueReference="3" dependencies="1"/>
  <Output valueReference="4" dependencies="2"/>"""
TICK = """<Clock name="tick" valueReference="1" causality="input"
  intervalVariability="triggered"/>"""
CLOCKED_3 = f"""{TICK}
<Int32 name="y" valueReference="5" causality="output" clocks="1" previous="6"/>
<Int32 name="before" valueReference="6" clocks="1" initial="exact" start="0"/>"""
CLOCKED_STRUCTURE_3 = """<Output valueReference="5" dependencies=""/>
  <ClockedState valueReference="5" dependencies="1"/>"""
STREAMED_3 = """
<Float64 name="flow" valueReference="1" causality="input" start="0"/>
<Float64 name="in" valueReference="2" causality="input" start="0"/>
<Float64 name="out" valueReference="3" causality="parameter" variability="fixed" start="0"/>"""
STREAM_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals><Terminal name="port" matchingRule="plug">
  <TerminalMemberVariable variableName="flow" memberName="m" variableKind="inflow"/>
  <TerminalStreamMemberVariable inStreamMemberName="a" outStreamMemberName="b"
    inStreamVariableName="in" outStreamVariableName="out"/></Terminal></Terminals>
</fmiTerminalsAndIcons>
"""

UNUSUAL: dict[str, dict[str, bytes]] = {
    "units": build_fmi_2(head=UNITS_2, variables=OUTPUT_2.format(unit=' unit="°C"')),
    "types": build_fmi_2(head=RADIAN + TYPES_2, variables=TYPED_2),
    "states, both kinds": build_fmi_2(
        attributes=' numberOfEventIndicators="2"',
        kinds=BOTH_2,
        variables=STATES_2,
        structure=STATES_STRUCTURE_2,
        files={"sources/cs/v.cpp": b""},
    ),
    "aliases": build_fmi_2(
        attributes=' variableNamingConvention="flat"', head=NEWTON, variables=ALIASES_2
    ),
    "categories and vendors": build_fmi_2(head=CATEGORIES_2 + VENDORS_2),
    "annotated variable": build_fmi_2(variables=ANNOTATED_2),
    "texts": build_fmi_2(variables=TEXTS_2, structure=TEXTS_STRUCTURE_2),
    "no output": build_fmi_2(variables=define_real("p", 0, PARAMETER, 'start="1"'), structure=""),
    "no dependencies": build_fmi_2(
        structure='<Outputs><Unknown index="1"/></Outputs>'
        '<InitialUnknowns><Unknown index="1"/></InitialUnknowns>'
    ),
    "quoted names": build_fmi_2(
        attributes=' variableNamingConvention="structured"', variables=QUOTED_2
    ),
    "declaration, comments and line ends": rewrite(build_fmi_2(), DECLARED_2),
    "past experiment": build_fmi_2(
        head='<DefaultExperiment startTime="-1e3" stopTime="-.5" tolerance="1" stepSize="+1."/>'
    ),
    "open experiment": build_fmi_2(head='<DefaultExperiment startTime="5"/>'),
    "copyright": build_fmi_2(
        attributes=' author="Ø &amp; &#x1F916;" copyright="© 2024" license="BSD &gt; MIT"'
        ' version="" generationTool="" generationDateAndTime="2024-02-29T23:59:59Z" description=""'
    ),
    "all flags": build_fmi_2(
        flags=' canGetAndSetFMUstate="1" canSerializeFMUstate="true" canInterpolateInputs="true"'
        ' canRunAsynchronuously="false" providesDirectionalDerivative="true"'
        ' canNotUseMemoryManagementFunctions="true" maxOutputDerivativeOrder="0"'
    ),
    "extra files": build_fmi_2(files=EXTRA_FILES),
    "nothing but time": build_fmi_3(),
    "arrays": build_fmi_3(variables=ARRAYS_3, structure=Y_3),
    "integers": build_fmi_3(variables=INTEGERS_3),
    "binaries": build_fmi_3(variables=BINARIES_3, structure=BINARIES_STRUCTURE_3),
    "clocks": build_fmi_3(variables=CLOCKS_3, structure=CLOCKS_STRUCTURE_3),
    "scheduled": build_fmi_3(kinds=SCHEDULED_3, variables=CLOCKS_3, structure=CLOCKS_STRUCTURE_3),
    "all kinds": build_fmi_3(kinds=ALL_KINDS_3),
    "types of FMI 3": build_fmi_3(head=UNITS_3 + TYPES_3, variables=TYPED_3, structure=Y_3),
    "states of FMI 3": build_fmi_3(
        kinds=EXCHANGE_3, variables=STATES_3, structure=STATES_STRUCTURE_3
    ),
    "terminals and icons": build_fmi_3(
        head=UNITS_3 + TYPES_3, variables=TYPED_3, structure=Y_3, files=ICONS
    ),
    "builds": build_fmi_3(
        files={
            "sources/buildDescription.xml": BUILD_SETS_3,
            "sources/more/v.cpp": b'#include "v.h"\n',
            "resources/include/v.h": b"",
            "sources/more/v.h": b"",
        }
    ),
    "annotations of FMI 3": build_fmi_3(tail=ANNOTATED_3),
    "patch version": build_fmi_3(version="3.0.2"),
    "files of FMI 3": build_fmi_3(files={**EXTRA_FILES, "documentation/licenses/LICENSE": b""}),
    "sizes by a constant": build_fmi_3(variables=SIZED_3),
    "derivatives of signals": build_fmi_3(
        kinds=EXCHANGE_3, variables=SLOPE_3, structure=SLOPE_STRUCTURE_3
    ),
    "clocked output": build_fmi_3(variables=CLOCKED_3, structure=CLOCKED_STRUCTURE_3),
    "streams": build_fmi_3(variables=STREAMED_3, files={ICON: STREAM_3}),
    "log categories of FMI 3": build_fmi_3(
        head='<LogCategories><Category name="logEvents"/></LogCategories>'
        '<DefaultExperiment tolerance="1e-12"/>'
    ),
}  # fmt: skip
"""FMUs without error or warning."""

UNREAD_BY_FMPY = {
    "type of a clock": build_fmi_3(head=CLOCK_TYPE, variables=TYPED_CLOCK),
    "type of binary data": build_fmi_3(head=BINARY_TYPE),
}
"""FMUs whose only warning is that FMPy cannot read them."""


def define_type(name: str, kind: str = "<Real/>") -> str:
    return f'<SimpleType name="{name}">{kind}</SimpleType>'


def define_types(*types: str) -> str:
    return f"<TypeDefinitions>{''.join(types)}</TypeDefinitions>"


Y_2 = OUTPUT_2.format(unit="")
ENUMERATION = "<Enumeration>{}</Enumeration>"
ITEM = '<Item name="{}" value="{}"/>'
NEWTONS_2 = OUTPUT_2.format(unit=' unit="N"')
OTHER_UNIT_2 = '<UnitDefinitions><Unit name="N"/><Unit name="lbf"/></UnitDefinitions>'
DERIVED_2 = Y_2 + define_real("p", 1, PARAMETER, 'start="1"') + "{}"
EXCHANGE_2 = """<ModelExchange modelIdentifier="u"><SourceFiles><File name="u.c"/></SourceFiles>
  </ModelExchange>"""
STATE_2 = define_real("x", 1, 'initial="exact"', 'start="0"')
RATE_2 = define_real("der(x)", 2, "{}", 'derivative="2"')
RATES_2 = "<Derivatives>{}</Derivatives>"
SWITCH_3 = """<TypeDefinitions><EnumerationType name="T"><Item name="on"
  value="9223372036854775807"/></EnumerationType></TypeDefinitions>"""
SWITCHED_3 = """<Enumeration name="s" valueReference="1" causality="parameter" variability="fixed"
  declaredType="T" start="9223372036854775806"/>"""
TWO_OF_3 = """<Float64 name="a" valueReference="1" causality="parameter" variability="fixed"
  start="1 2"><Dimension start="3"/></Float64>"""
UNSTARTED_3 = '<Float64 name="u" valueReference="1" causality="input"/>'
PIN = b"""<?xml version="1.0" encoding="UTF-8"?><fmiTerminalsAndIcons fmiVersion="3.0">%b
  <Terminals>%b</Terminals></fmiTerminalsAndIcons>"""
TERMINAL = b'<Terminal name="a" matchingRule="none">%b</Terminal>'
NO_MEMBER = TERMINAL % b'<TerminalMemberVariable variableName="z" variableKind="signal"/>'
NO_ICON = b"""<GraphicalRepresentation><CoordinateSystem suggestedScalingFactorTo_mm="1" x1="0"
  y1="0" x2="1" y2="1"/><Icon x1="0" y1="0" x2="1" y2="1"/></GraphicalRepresentation>"""
LATIN_1 = rewrite(build_fmi_3(), '<?xml version="1.0" encoding="ISO-8859-1"?>\n')
UNLISTED_3 = build_fmi_3()
del UNLISTED_3["sources/buildDescription.xml"]
WRONG_BUILD = {"sources/buildDescription.xml": BUILD_3.replace(b"SourceFileSet>", b"Sources>")}

VIOLATIONS: dict[str, dict[str, bytes]] = {
    "kind-missing error": build_fmi_2(kinds="<!-- none -->"),
    "kind-identifier error": build_fmi_3(kinds='<CoSimulation modelIdentifier="a.b"/>'),
    "kind-state error": build_fmi_3(
        kinds='<CoSimulation modelIdentifier="u" canSerializeFMUState="true"/>'),
    "token-empty error": rewrite(
        {MODEL: build_fmi_3()[MODEL].replace(b'"any text"', b'""'), "sources/u.c": b""},
        '<?xml version="1.0" encoding="UTF-8"?>\n'),
    "experiment-times warning": build_fmi_3(head='<DefaultExperiment stopTime="INF"/>'),
    "experiment-step advice": build_fmi_2(
        head='<DefaultExperiment startTime="0" stopTime="1" stepSize="2"/>'),
    "unit-twice error": build_fmi_2(
        head=NEWTON.replace("</Unit>", '<DisplayUnit name="kN"/></Unit>')),
    "unit-ignored advice": build_fmi_2(
        head=NEWTON, variables=OUTPUT_2.format(unit=' unit="N" displayUnit="N"')),
    "type-twice error": build_fmi_2(
        head=define_types(define_type("T", ENUMERATION.format(
            ITEM.format("a", 1) + ITEM.format("b", 1))))),
    "type-name error": build_fmi_2(head=define_types(define_type("y"))),
    "category-twice error": build_fmi_2(head=CATEGORIES_2.replace("my own category", "logAll")),
    "variable-range error": build_fmi_3(
        variables=INTEGERS_3.replace('start="255"', 'start="256"')),
    "variable-item error": build_fmi_3(head=SWITCH_3, variables=SWITCHED_3),
    "variable-type error": build_fmi_2(
        head=define_types(define_type("T", "<Integer/>")),
        variables=OUTPUT_2.format(unit=' declaredType="T"')),
    "variable-unit error": build_fmi_2(variables=OUTPUT_2.format(unit=' displayUnit="kN"')),
    "variable-derivative error": build_fmi_2(
        variables=DERIVED_2.format(define_real("v", 2, "", 'derivative="2"'))),
    "variable-independent error": build_fmi_2(
        variables=Y_2 + define_real("t", 1, 'causality="independent"')
        + define_real("s", 2, 'causality="independent"')),
    "variable-size error": build_fmi_3(variables=TWO_OF_3),
    "alias-constant error": build_fmi_2(
        variables=ALIASES_2.replace('start="1"', 'start="2"', 1), head=NEWTON),
    "alias-settable error": build_fmi_2(
        variables=Y_2 + define_real("p", 1, PARAMETER, 'start="1"')
        + define_real("q", 1, PARAMETER, 'start="1"')),
    "alias-unit warning": build_fmi_2(
        head=OTHER_UNIT_2, variables=NEWTONS_2 + define_real("z", 0, "", 'unit="lbf"')),
    "structure-derivatives error": build_fmi_2(
        kinds=EXCHANGE_2, variables=Y_2 + STATE_2 + RATE_2.format('variability="discrete"'),
        structure=OUTPUTS_2.replace("<Init", RATES_2.format('<Unknown index="3"/>') + "<Init")),
    "structure-states warning": build_fmi_2(
        kinds=EXCHANGE_2, variables=Y_2 + STATE_2 + RATE_2.format("")),
    "structure-index error": build_fmi_3(structure='<Output valueReference="77"/>'),
    "structure-loops advice": build_fmi_2(
        variables=Y_2 + define_real("u", 1, 'causality="input"', 'start="0"'),
        structure=OUTPUTS_2.replace(' dependencies=""', "")),
    "type-unit error": build_fmi_2(head=define_types(define_type("T", '<Real unit="kg"/>'))),
    "variable-name error": build_fmi_2(variables=Y_2 + define_real("", 1)),
    "variable-range error type": build_fmi_2(
        head=define_types(define_type("T", '<Real min="2" max="1"/>'))),
    "variable-attribute error": build_fmi_3(
        kinds=EXCHANGE_3,
        variables=STATES_3.replace('start="0"/>', 'start="0" reinit="true"/>'),
        structure=STATES_STRUCTURE_3),
    "variable-attribute error update": build_fmi_3(
        variables=INTEGERS_3.replace('start="255"', 'start="255" intermediateUpdate="true"')),
    "variable-clock error": build_fmi_3(
        variables='<Int32 name="n" valueReference="1" clocks="0"/>'),
    "variable-clock error interval": build_fmi_3(
        variables=TICK.replace("triggered", "constant")),
    "variable-clock error zero": build_fmi_3(
        variables=CLOCKS_3.replace("0.01", "0"), structure=CLOCKS_STRUCTURE_3),
    "variable-clock error previous": build_fmi_3(
        variables=CLOCKED_3.replace('previous="6"', 'previous="5"'),
        structure=CLOCKED_STRUCTURE_3),
    "variable-clock error continuous": build_fmi_3(
        variables=TICK + '<Float64 name="x" valueReference="2" clocks="1"/>'),
    "variable-clock error priority": build_fmi_3(kinds=SCHEDULED_3, variables=TICK),
    "variable-size error reference": build_fmi_3(
        variables=SIZED_3.replace('variability="constant"', 'causality="local"', 1)),
    "variable-size error zero": build_fmi_3(
        variables=SIZED_3.replace('start="3"', 'start="0"')),
    "variable-size error both": build_fmi_3(
        variables=SIZED_3.replace("<Dimension ", '<Dimension start="3" ')),
    "structure-kind error": build_fmi_2(
        kinds=BOTH_2, variables=STATES_2, structure=STATES_STRUCTURE_2.replace(
            'index="5"', 'index="5" dependencies="1" dependenciesKind="fixed"')),
    "structure-clocks error": build_fmi_3(
        variables=CLOCKED_3, structure='<Output valueReference="5" dependencies=""/>'),
    "structure-index error clocked": build_fmi_3(structure='<ClockedState valueReference="77"/>'),
    "structure-dependency error": build_fmi_3(
        kinds=EXCHANGE_3, variables=STATES_3, structure=STATES_STRUCTURE_3.replace(
            'valueReference="2" dependencies="10"', 'valueReference="2" dependencies="77"')),
    "structure-derivatives error event": build_fmi_3(
        variables=INTEGERS_3, structure='<EventIndicator valueReference="1"/>'),
    "terminal-member error stream": build_fmi_3(
        variables=STREAMED_3, files={ICON: STREAM_3.replace(b'"out"', b'"outer"')}),
    "terminal-member error name": build_fmi_3(
        variables=STREAMED_3, files={ICON: STREAM_3.replace(b'memberName="m"', b"")}),
    "fmpy error display unit": build_fmi_3(
        head=UNITS_3, variables=UNSTARTED_3.replace("/>", ' start="0" unit="K" displayUnit="F"/>')),
    "terminal-twice error": build_fmi_3(files={ICON: PIN % (b"", 2 * (TERMINAL % b""))}),
    "terminal-member error": build_fmi_3(files={ICON: PIN % (b"", NO_MEMBER)}),
    "terminal-icon warning": build_fmi_3(files={ICON: PIN % (NO_ICON, TERMINAL % b"")}),
    "binary-none error": UNLISTED_3,
    "binary-missing error": build_fmi_3(files={"binaries/x86_64-linux/other.so": b""}),
    "source-missing error": build_fmi_3(files={
        "sources/buildDescription.xml": BUILD_3.replace(b"u.c", b"v.c")}),
    "source-include warning": build_fmi_3(files={"sources/u.c": b'#include "v.h"'}),
    "xml-unreadable error": build_fmi_2(head="<unclosed>"),
    "xml-encoding error": LATIN_1,
    "xsd error": build_fmi_3(files=WRONG_BUILD),
    "fmpy error": build_fmi_3(variables=UNSTARTED_3),
    "fmi-version error": rewrite(build_fmi_3(version="4.0"),
                                 '<?xml version="1.0" encoding="UTF-8"?>\n'),
    "archive-case warning": build_fmi_2(files={"README": b"", "readme": b""}),
    "archive-entry error": build_fmi_2(files={"../outside": b""}),
}  # fmt: skip
"""FMUs by the rule that one violation breaks, and its severity."""
