"""Copies of users' models in which only the numbers change, compared byte by byte."""

import difflib
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
from documents import ROOT

from hesr.extras.reduction.export import edit_copy, find_joint
from hesr.extras.reduction.formats import (
    MJCF_JOINT,
    SDF_DYNAMICS,
    URDF_DYNAMICS,
    TextFormat,
)
from hesr.extras.reduction.projection import Price, ReducedJoint
from hesr.extras.reduction.xml_copy import XmlCopy
from hesr_model.errors import ExportError
from hesr_model.friction.servo import JointServo

PRICE = Price(
    law_rmse=0.1, rmse=0.2, lost_variance=0.01, energy=1.0, speeds=(0.0, 1.0), loads=(0.0, 1.0)
)


def joint_of(name: str) -> ReducedJoint:
    return ReducedJoint(
        name=name,
        frictionloss=1.5,
        damping=0.25,
        armature=0.125,
        sliding=False,
        inertia=1.0,
        price=PRICE,
    )


def edit(path: Path, text_format: TextFormat, *joints: ReducedJoint) -> tuple[bytes, list[str]]:
    copy = XmlCopy(path)
    elements = [find_joint(copy, text_format, joint.name) for joint in joints]
    return edit_copy(copy, text_format, joints, elements, ["a -- b", "price"])


def list_changes(before: bytes, after: bytes) -> list[tuple[bytes, bytes]]:
    """Return the pairs of bytes that differ."""
    matcher = difflib.SequenceMatcher(None, before, after, autojunk=False)
    return [
        (before[i1:i2], after[j1:j2])
        for tag, i1, i2, j1, j2 in matcher.get_opcodes()
        if tag != "equal"
    ]


def require_insertions(before: bytes, after: bytes, *insertions: bytes) -> None:
    """Check that a copy is the file with some insertions, in this order, and nothing else."""
    rest = after
    for insertion in insertions:
        head, found, rest_of_copy = rest.partition(insertion)
        assert found, insertion
        assert before.startswith(head)
        before = before[len(head) :]
        rest = rest_of_copy
    assert rest == before


COMMENT = b"<!-- HESR: a - - b\n     price -->\n"
NEW = b' damping="0.25" frictionloss="1.5" solreffriction="0.004 1" armature="0.125"'

MJCF = b"""<?xml version='1.0' encoding="utf-8"?>
<!-- an arm -- with dashes, as MuJoCo allows: <joint name="lift"/> -->
<mujoco   model='arm'>
\t<include file="assets.xml" />
  <default><joint damping="9"/>
    <default class="big"><joint damping="7" armature="3" frictionloss="2"/></default>
  </default>
  <worldbody><body name="a" childclass="big"><geom size=".1"/>
      <joint axis="0 0 1"   name="pan"/><!-- pan -->
      <body><joint name='lift'
          type="hinge" damping='1 2'  armature = "4"
          class="big" ></joint><geom size=".1"/></body>
  </body></worldbody>
  <equality><joint name="lift" joint1="pan" joint2="lift"/></equality>
  <actuator><position kp="1" joint="lift" dampratio="1"/><motor joint="pan"/></actuator>
</mujoco>
<!-- end -->"""


def test_an_mjcf_keeps_all_else(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_bytes(MJCF)
    data, remarks = edit(path, MJCF_JOINT, joint_of("pan"))
    require_insertions(MJCF, data, COMMENT, NEW)
    assert remarks == []
    assert data.index(COMMENT) > data.index(b"with dashes")


def test_attributes_of_an_mjcf_keep_their_quotes(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_bytes(MJCF)
    data, _ = edit(path, MJCF_JOINT, joint_of("lift"))
    changed = MJCF.replace(
        b"damping='1 2'  armature = \"4\"", b"damping='0.25'  armature = \"0.125\""
    )
    changed = changed.replace(
        b'class="big" >', b'class="big" frictionloss="1.5" solreffriction="0.004 1" >'
    )
    require_insertions(changed, data, COMMENT)


def test_an_edited_mjcf_compiles_to_the_numbers_and_the_servo(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_bytes(MJCF)
    (tmp_path / "assets.xml").write_text("<mujoco><option/></mujoco>")
    servo = JointServo(kp=20.0, kd=1.5, torque_limit=3.0)
    served = [replace(joint_of(name), servo=servo) for name in ("pan", "lift")]
    data, [remark] = edit(path, MJCF_JOINT, *served)
    assert "no <position> acts on joint 'pan'" in remark
    (tmp_path / "copy.xml").write_bytes(data)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "copy.xml"))
    assert list(model.dof_frictionloss) == [1.5, 1.5]
    assert list(model.dof_armature) == [0.125, 0.125]
    assert model.dof_damping.reshape(2, -1)[:, 0].tolist() == [0.25, 0.25]
    assert list(model.actuator_forcerange[0]) == [-3.0, 3.0]
    assert list(model.actuator_biasprm[0, 1:3]) == [-20.0, -1.5]
    served[0] = replace(served[0], servo=replace(servo, kp=30.0))
    (tmp_path / "again.xml").write_bytes(data)
    again, _ = edit(tmp_path / "again.xml", MJCF_JOINT, *served)
    assert again == data  # a second export replaces the comment of the first


URDF = b"""<robot name="arm" xmlns:xacro="x">\r
  <link name="a"/><link name="b"/><link name="c"/>\r
  <joint name="pan" type="revolute">\r
    <parent link="a"/>\r
    <child link="b"/>\r
  </joint>\r
  <joint type='revolute' name='lift'><parent link="b"/><child link="c"/>\r
     <dynamics  friction='0' \r
        damping="3.0"/></joint>\r
  <transmission name="t"><joint name="pan"/></transmission>\r
  <drake:x name="y"/>\r
</robot>\r
"""


def test_a_urdf_keeps_all_else(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_bytes(URDF)
    data, _ = edit(path, URDF_DYNAMICS, joint_of("lift"), joint_of("pan"))
    changed = URDF.replace(b"friction='0'", b"friction='1.5'").replace(b'"3.0"', b'"0.25"')
    comment = COMMENT.replace(b"\n", b"\r\n")
    dynamics = b'\r\n    <dynamics damping="0.25" friction="1.5" />'
    require_insertions(changed, data, comment, dynamics)


SDF = b"""<?xml version="1.0"?>
<sdf version="1.9"><world name="w"><model name="arm">
  <joint name="pan" type="revolute"><axis>
      <xyz>0 0 1</xyz>
    </axis></joint>
  <joint name="lift" type="revolute"><axis>
    <dynamics><damping>9</damping><spring_stiffness>0</spring_stiffness></dynamics></axis></joint>
  <joint name="roll" type="revolute"><axis><dynamics/></axis></joint>
  <joint name="weld" type="fixed"/>
</model></world></sdf>
"""


def test_an_sdf_keeps_all_else(tmp_path: Path) -> None:
    path = tmp_path / "arm.sdf"
    path.write_bytes(SDF)
    joints = [joint_of(name) for name in ("pan", "lift", "roll")]
    data, _ = edit(path, SDF_DYNAMICS, *joints)
    both = b"<damping>0.25</damping><friction>1.5</friction>"
    changed = SDF.replace(b"<damping>9<", b"<damping>0.25<")
    changed = changed.replace(b"<axis><dynamics/>", b"<axis><dynamics>" + both + b"</dynamics>")
    require_insertions(
        changed,
        data,
        COMMENT,
        b"\n      <dynamics>" + both + b"</dynamics>",
        b"<friction>1.5</friction>",
    )
    with pytest.raises(ExportError, match="'weld' has no <axis>"):
        edit(path, SDF_DYNAMICS, joint_of("weld"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"<mujoco><worldbody/></mujoco>", r"has no joint 'pan' of the law\.$"),
        (b'<mujoco><include file="b.xml"/></mujoco>', r"included file \(b\.xml\)"),
        (b"<m><a><joint name='pan'/></a><a><joint name='pan'/></a></m>", "has 2 joints 'pan'"),
        (b"<!DOCTYPE x><m/>", "document type"),
        (b"<m><a></m>", "closes <m>"),
        (b"<m><a>", "not well-formed"),
        (b"<m/><m/>", "several roots"),
        (b"<m a='</m>", "not well-formed"),
        ("<m/>".encode("utf-16"), "another encoding"),
        (b"", "not well-formed"),
    ],
)
def test_what_cannot_be_copied_is_refused(tmp_path: Path, text: bytes, sentence: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_bytes(text)
    with pytest.raises(ExportError, match=sentence):
        edit(path, MJCF_JOINT, joint_of("pan"))


URDFS = [*(ROOT / "models").rglob("*.urdf"), *(ROOT.parent / "shared").rglob("*.urdf")]


@pytest.mark.parametrize(
    "path",
    sorted(path for path in URDFS if path.stem != "LICENSE"),
    ids=lambda path: f"{path.parent.name}-{path.stem}",
)
def test_urdfs_of_robots_keep_all_but_their_dynamics(path: Path) -> None:
    """Without the comment and the numbers, copy and original are the same bytes."""
    names = re.findall(
        rb'<joint[^>]*name="([^"]+)"[^>]*type="(?:revolute|prismatic|continuous)"',
        path.read_bytes(),
    )
    joints = [joint_of(name.decode()) for name in dict.fromkeys(names)]
    data, _ = edit(path, URDF_DYNAMICS, *joints)
    assert data.count(b'friction="1.5"') == len(joints)
    bare = re.compile(rb"\s*<dynamics [^>]*/>")
    without_comment = re.sub(rb"<!-- HESR:.*?-->\r?\n", b"", data, flags=re.DOTALL)
    assert bare.sub(b"", without_comment) == bare.sub(b"", path.read_bytes())
