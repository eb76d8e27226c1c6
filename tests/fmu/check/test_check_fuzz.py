"""Any bytes in a file give a report."""

import zipfile
from io import BytesIO

import pytest
from fmu_files import MODEL, members
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.run import Report, check
from hesr_model.support.process import DiedError

pytestmark = pytest.mark.ci

QUIET = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def alone(monkeypatch):
    """Start no other processes; their work does not depend on the bytes of the archive."""

    def not_run(*_arguments):
        raise DiedError("was not run")

    monkeypatch.setattr(ReaderProcess, "run", not_run)


@pytest.fixture(scope="module")
def small(source_fmu):
    """Few and small entries, so that every header is hit."""
    content = members(source_fmu)
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (MODEL, "sources/all.c", "documentation/index.html"):
            archive.writestr(name, content[name][:20_000] if name != MODEL else content[name])
    return out.getvalue()


def assert_report(path, data):
    path.write_bytes(data)
    report = check(path)
    assert isinstance(report, Report)
    assert all(p.found.isprintable() and p.found.endswith((".", "?", "!")) for p in report.problems)


@QUIET
@given(
    flips=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=8
    ),
    tail=st.booleans(),
)
def test_flipped_bytes_give_a_report(flips, tail, small, tmp_path, alone):
    """Anywhere, or only in the table of contents."""
    data = bytearray(small)
    start = small.index(b"PK\1\2") if tail else 0
    for where, mask in flips:
        data[start + int(where * (len(data) - start))] ^= mask
    assert_report(tmp_path / "F.fmu", bytes(data))


@QUIET
@given(part=st.floats(0, 1), end=st.floats(0, 1), more=st.binary(max_size=60))
def test_removed_pieces_give_a_report(part, end, more, small, tmp_path, alone):
    first, last = sorted((int(part * len(small)), int(end * len(small))))
    assert_report(tmp_path / "F.fmu", small[:first] + more + small[last:])


@QUIET
@given(data=st.data())
def test_changed_xml_gives_a_report(data, small, tmp_path, alone, source_fmu):
    """The archive stays valid, whether the XML is well-formed or not."""
    xml = bytearray(members(source_fmu)[MODEL])
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(xml) - 1))
        xml[place : place + data.draw(st.integers(0, 30))] = data.draw(
            st.sampled_from([b"", b"9", b"-", b"\xff", b"\0", b'"', b"<", b"NaN", b"1e999", b" "])
        )
    out = BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(MODEL, bytes(xml))
    assert_report(tmp_path / "F.fmu", out.getvalue())
