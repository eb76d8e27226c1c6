"""Where the results come from."""

from importlib.metadata import version

from markupsafe import Markup

from cosim.report.markup import Pictures, Section, details, joined, paragraph, table
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, row_of


def section(results: Results, pictures: Pictures) -> Section:
    """Give the command, the seed, the versions, and the hashes of what was read."""
    del pictures
    run = results.run
    versions = ", ".join(f"{name} {number}" for name, number in run.versions.items())
    files = dict.fromkeys((log.file, log.sha256) for log in run.logs)
    logs = {log.sha256 for log in run.logs}
    for file in results.provenance.get("files", ()):
        if file["sha256"] not in logs:
            files[file["name"], file["sha256"]] = None
    hashes = ResultTable(
        caption="SHA-256 of what the results come from",
        head=("file", "SHA-256"),
        rows=[row_of(name, Markup("<code>{}</code>").format(digest)) for name, digest in files],
        numeric=False,
    )
    return Section(
        key="provenance",
        title="Provenance",
        html=joined(
            Markup("<p>Made by <code>{}</code>, seed {}. Versions: {}.</p>").format(
                run.command, run.seed, versions
            ),
            paragraph(
                "The same logs, seed and versions give the same laws bit for bit on the same "
                "machine. Beside this page: the laws as JSON (laws/), the FMUs (fmus/), all scores "
                "(evaluation.json), and the figures as PDF and PNG (figures/)."
            ),
            details("Hashes of the files", table(hashes)),
            paragraph(f"Zooming by Bokeh {version('bokeh')} (BSD 3-Clause).", note=True),
        ),
    )
