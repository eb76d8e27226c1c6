"""Meaning of a column's name: units first, then words of several languages, then letters."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import NamedTuple

UnitSize = str | float  # a unit of a robot file: its name, or its size in SI

# How sure a reading is; the lower, the surer.
BY_UNIT = 0
BY_WORD = 1  # by its last word of a quantity: 'q_current' is a current
BY_OTHER_WORD = 2  # by an earlier word, which may describe the last one: 'current_position'
BY_LETTER = 3  # by a letter that stands alone, as 'v'


class Reading(NamedTuple):
    """A meaning of a column, with its unit unless that is SI, and how sure it is."""

    quantity: str
    rank: int
    unit: UnitSize = ""


def _split_words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_QUANTITY_WORDS: Mapping[str, frozenset[str]] = {
    "temperature": _split_words(
        "temperature temperatures temp temps temperatur temperatura motortemperatur"
    ),
    "dq": _split_words(
        "dq qd qdot dqdt qvel vel velocity velocities speed speeds omega qp rpm geschwindigkeit"
        " drehzahl winkelgeschwindigkeit vitesse vitesses velocidad velocidade velocita"
    ),
    "q": _split_words(
        "q qpos pos position positions angle angles theta phi qm encoder enc displacement stroke"
        " winkel weg hub lage drehwinkel posicion posicao posizione angulo angolo deplacement"
    ),
    "tau": _split_words(
        "tau qfrc torque torques trq eff effort efforts moment moments drehmoment motormoment tq nm"
        " force forces kraft couple couples coppia forza fuerza torsor momento"
    ),
    "current": _split_words(
        "i im cur curr current currents amp amps ampere amperes iq strom motorstrom courant"
        " corriente corrente"
    ),
}  # Words in column names
FORCE_WORDS = _split_words("force forces kraft forza fuerza")  # torques of sliding joints
COMMANDED_QUANTITIES = ("q", "dq")  # quantities whose commands are read
_JOINT_WORDS = _split_words("joint axis achse axe eje asse")  # positions, unless another matches
_COMMAND_WORDS = _split_words(
    "target desired des ref reference cmd command commanded setpoint set sp goal demand soll"
    " sollwert consigne consigna"
)
_IGNORED_WORDS = _split_words(
    "acc acceleration accelerations accel ddq qdd qddot error err tcp ext external voltage volt"
    " volts spannung ddot window limit mode status dir control power electrical elec dtau"
    " beschleunigung aceleracion accelerazione rated nominal"
)
_MOTOR_WORDS = _split_words("qm motor motors")
MEASURED_WORDS = _split_words(
    "actual act meas measured msr present ist istwert feedback fb mesure medido misurato real"
)
TIME_WORDS = _split_words(
    "t time timestamp timestamps stamp datetime date clock unix secs seconds sec zeit temps tiempo"
    " tempo"
)
_LETTERS: Mapping[str, str] = {
    **dict.fromkeys("xs", "q"),
    **dict.fromkeys("vwn", "dq"),
    **dict.fromkeys("mf", "tau"),
}  # Symbols of textbooks, if nothing else is in a name
# Words of data sets for the learning of motions (LeRobot), of robots that follow positions.
_DATA_SET_WORDS = {("observation", "state"): "q", ("action",): "q_cmd"}
_AXIS_SYMBOLS = {"iq": "current", "vq": "dq"}  # 'v_q' may be the voltage of the q axis
_IGNORED_SYMBOLS = _split_words("id vd ud uq")
# Words of other scripts, which have no spaces; longer ones first.
_OTHER_SCRIPTS: Mapping[str, str] = {
    "加速度": "acceleration", "角速度": "velocity", "速度": "velocity", "回転数": "velocity",
    "转速": "velocity", "位置": "position", "角度": "angle", "トルク": "torque",
    "扭矩": "torque", "转矩": "torque", "力矩": "torque", "電流": "current", "电流": "current",
    "電圧": "voltage", "电压": "voltage", "時間": "time", "时间": "time", "温度": "temperature",
    "目標": "target", "目标": "target", "指令": "command",
}  # fmt: skip

_UNITS: Mapping[str, Mapping[str, UnitSize]] = {
    "q": {
        **dict.fromkeys(("rad", "radian", "radians", "m", "meter", "metre"), ""),
        **dict.fromkeys(("deg", "degree", "degrees", "grad", "°"), "deg"),
        **dict.fromkeys(("rev", "revs", "turn", "turns", "revolutions"), "rev"),
        **dict.fromkeys(("mm", "millimeter", "millimetre"), "mm"),
        "mrad": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "inch": 0.0254,
    },
    "dq": {
        **dict.fromkeys(("rad/s", "rads", "radps", "rad/sec", "radpers", "m/s", "mps"), ""),
        **dict.fromkeys(("deg/s", "degs", "dps", "degps", "deg/sec", "degpers", "°/s"), "deg/s"),
        "grad/s": "deg/s",
        **dict.fromkeys(("rpm", "r/min", "rev/min", "1/min", "min-1", "min^-1", "u/min"), "rpm"),
        **dict.fromkeys(("umin", "tr/min", "tours/min"), "rpm"),
        **dict.fromkeys(("rev/s", "rps", "revs/s", "turns/s"), "rev/s"),
        **dict.fromkeys(("mm/s", "mmps"), "mm/s"),
        "mrad/s": 1e-3, "cm/s": 1e-2,
    },
    "tau": {
        **dict.fromkeys(("nm", "n.m", "n-m", "newton", "n"), ""),
        **dict.fromkeys(("mnm", "mn.m"), "mN.m"),
        "knm": 1e3, "kn.m": 1e3, "ncm": 1e-2, "n.cm": 1e-2, "nmm": 1e-3, "n.mm": 1e-3, "kn": 1e3,
    },
    "current": {
        **dict.fromkeys(("a", "amp", "amps", "ampere", "amperes", "arms", "a_rms", "apk"), ""),
        **dict.fromkeys(("ma", "milliamp", "milliamps"), "mA"),
    },
    "temperature": {
        **dict.fromkeys(("degc", "°c", "celsius", "c"), ""), "kelvin": "K", "k": "K",
    },
    "t": {
        **dict.fromkeys(("s", "sec", "secs", "seconds"), ""),
        **dict.fromkeys(("ms", "msec", "msecs", "milliseconds"), "ms"),
        **dict.fromkeys(("us", "usec", "usecs", "µs", "microseconds"), "us"),
        **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
    },
    "": dict.fromkeys(
        (
            *("v", "mv", "kv", "volt", "volts", "w", "kw", "watt", "watts", "hz", "khz", "bar"),
            *("pa", "kpa", "mpa", "kg", "j", "rad/s2", "rad/s^2", "rad/ss", "deg/s2", "deg/s^2"),
            *("m/s2", "m/s^2", "mm/s2", "mm/s^2"),
        ),
        "",
    ),
}  # fmt: skip
"""Spellings of units in lower case, by quantity; those of other quantities belong to ''."""
_QUANTITY_OF_UNIT: dict[str, str] = {}
for _quantity, _spellings in _UNITS.items():
    _QUANTITY_OF_UNIT |= dict.fromkeys(_spellings, _quantity)
# Ends of the names of two columns that are one time: whole seconds, and what has passed since.
FRACTION_ENDINGS = {
    "ns": ("nanosec", "nanosecs", "nanoseconds", "nsec", "nsecs", "ns"),
    "us": ("microsec", "microsecs", "microseconds", "usec", "usecs", "us"),
    "ms": ("millisec", "millisecs", "milliseconds", "msec", "msecs", "ms"),
}
SECONDS_ENDINGS = ("seconds", "secs", "sec", "s")
# Spellings that are words or letters of other things, unless they are in brackets.
_BRACKET_ONLY = _split_words("m n a c k s v w j bar pa mv arms inch turn rev turns")
_BRACKETS = re.compile(r"[\[(<]([^\[\]()<>]*)[\])>]")
_SLASH_SUFFIX = re.compile(r"\s(?:/|in)\s+(\S+)$")  # 'speed / rpm', 'speed in rpm'
_SEPARATED = re.compile(
    r"(?<=[a-z°])[_ ]per[_ ](?=[a-z])"
    r"|(?:(?<=rad|deg|rev|\dmm|_mm|\dcm|_cm)|(?<=\dm|_m))_(?=s$|s[_ ])"  # 'v1_mm_s'
)
_TOKEN = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|°")
_AXES = re.compile(r"(?<![A-Za-z])([iIuUvV])[_ ]?([dq])(?![A-Za-z])")  # i_q is a current
_FIELD_AXIS = re.compile(r"(?<![A-Za-z])[dqDQ][-_ ]?axis(?![A-Za-z])")  # of a field, no position


def split_tokens(name: str) -> list[str]:
    """Return the words of a name in lower case, without accents."""
    for text, word in _OTHER_SCRIPTS.items():
        name = name.replace(text, f" {word} ")
    plain = unicodedata.normalize("NFKD", name)
    plain = "".join(character for character in plain if not unicodedata.combining(character))
    plain = _FIELD_AXIS.sub(" ", plain)
    return [token.lower() for token in _TOKEN.findall(_AXES.sub(r"\1\2", plain))]


def read_unit(name: str) -> tuple[str, UnitSize] | None:
    """Return quantity and unit of a name with a unit, '' for SI; the quantity of others is ''."""
    bracketed = [text for text in _BRACKETS.findall(name) if re.search(r"[A-Za-z°µ]", text)]
    slashed = _SLASH_SUFFIX.findall(name)
    for text in (*reversed(bracketed), *slashed):
        spelling = _normalise_unit(text)
        if spelling in _QUANTITY_OF_UNIT:
            quantity = _QUANTITY_OF_UNIT[spelling]
            return quantity, _UNITS[quantity][spelling]
    lower = _SEPARATED.sub("/", _BRACKETS.sub(" ", name).lower())
    words = [word for word in re.split(r"[^a-z°µ/]+", lower) if word]
    camel_words = split_tokens(name)
    # The last word is a unit more often than an earlier one.
    for word in (*reversed(words), *reversed(camel_words)):
        if word in _QUANTITY_OF_UNIT and word not in _BRACKET_ONLY:
            quantity = _QUANTITY_OF_UNIT[word]
            return quantity, _UNITS[quantity][word]
    return None


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of a signal."""
    return _normalise_unit(text) in _QUANTITY_OF_UNIT


def simplify_name(name: str) -> str:
    """Return a name in lower case, without what is in brackets, as a unit."""
    return _BRACKETS.sub("", name).strip().lower()


def find_fraction_unit(name: str) -> str:
    """Return the unit of a column of what has passed since whole seconds; ns by default."""
    plain = simplify_name(name)
    for unit, endings in FRACTION_ENDINGS.items():
        if plain.endswith(endings):
            return unit
    return "ns"


def _normalise_unit(text: str) -> str:
    spelling = text.strip().lower().replace(" ", "").replace("²", "2").replace("⁻¹", "-1")
    return re.sub(r"[·*⋅]", ".", spelling)


def read_name(name: str) -> list[Reading]:
    """Return the possible meanings of a column, the surest first.

    A unit outranks any word. Commands have the quantities ``q_cmd`` and ``dq_cmd``; names of other
    signals, such as voltages or torques of commands, have no meaning.
    """
    tokens = split_tokens(_BRACKETS.sub(" ", name))
    unit = read_unit(name)
    if unit == ("", "") or not _IGNORED_WORDS.isdisjoint(tokens):
        return []
    readings = _read_words(tokens)
    if not readings and len(tokens) == 1 and tokens[0] in _LETTERS:
        readings = [Reading(_LETTERS[tokens[0]], BY_LETTER)]
    if tuple(tokens) in _DATA_SET_WORDS:
        readings = [Reading(_DATA_SET_WORDS[tuple(tokens)], BY_OTHER_WORD)]
    if unit is not None:
        readings = [Reading(unit[0], BY_UNIT, unit[1])]
    if unit is not None and unit[0] == "t":
        readings = []
    is_command = not _COMMAND_WORDS.isdisjoint(tokens) or _ends_as_desired(tokens)
    if not is_command:
        return readings
    return [
        Reading(f"{reading.quantity}_cmd", reading.rank, reading.unit)
        for reading in readings
        if reading.quantity in COMMANDED_QUANTITIES
    ]


def _ends_as_desired(tokens: Sequence[str]) -> bool:
    """Return whether a name ends as in 'q_d', the desired position."""
    return len(tokens) > 1 and tokens[-1] == "d" and bool(_read_words(tokens[:-1]))


def _read_words(tokens: Sequence[str]) -> list[Reading]:
    readings: list[Reading] = []
    for token in reversed(tokens):
        for quantity, words in _QUANTITY_WORDS.items():
            is_new = all(reading.quantity != quantity for reading in readings)
            if token in words and is_new:
                rank = BY_OTHER_WORD if readings else BY_WORD
                readings.append(Reading(quantity, rank))
        if token in _AXIS_SYMBOLS and not readings:
            readings.append(Reading(_AXIS_SYMBOLS[token], BY_LETTER))
    if not _IGNORED_SYMBOLS.isdisjoint(tokens):
        return []
    if "dot" in tokens and any(reading.quantity == "q" for reading in readings):
        return [Reading("dq", BY_WORD)]  # 'theta_dot'
    if not readings and not _JOINT_WORDS.isdisjoint(tokens):
        readings = [Reading("q", BY_OTHER_WORD)]
    return readings


def is_of_motor(name: str) -> bool:
    """Return whether a column is named like a motor's."""
    return not _MOTOR_WORDS.isdisjoint(split_tokens(name))
