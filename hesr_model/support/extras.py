"""Commands that install packages for optional features."""

PUBLISHED = False  # a release sets True, see docs/release.md


def install_command(extra: str) -> str:
    """Return the command that installs an extra of HESR."""
    if PUBLISHED:
        return f"pip install 'hesr[{extra}]'"
    return f"pip install '.[{extra}]' in HESR's folder"
