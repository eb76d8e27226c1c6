"""Types of the options of `hesr.export`, with those of other packages.

`python -m hesr.export_types FOLDER` writes a package of stubs, `cosim-stubs`, into a folder on the
path of a type checker, by default that of installed packages. It adds the options of all installed
export formats, and has to run again after such a package is installed.
"""

import sys
import sysconfig
from pathlib import Path

from cosim.workflow.export_formats import export_options_code
from hesr_model.support.files import written_whole


def write_stubs(folder: Path) -> Path:
    """Write the stubs into a folder, and return their module."""
    package = folder / "cosim-stubs"
    module = package / "workflow" / "export_options.pyi"
    module.parent.mkdir(parents=True, exist_ok=True)
    texts = {package / "py.typed": "partial\n", module: export_options_code()}
    for path, text in texts.items():
        with written_whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return module


if __name__ == "__main__":
    write_stubs(Path(sys.argv[1] if len(sys.argv) > 1 else sysconfig.get_path("purelib")))
