"""Options that hold a number for each joint."""

from hesr_model.errors import ConfigError


def numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    """Return numbers with commas between them; None where the option is not given.

    Raises
    ------
    ConfigError
        If the text holds anything else.
    """
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(
            f"{option} is '{text}'; needed are numbers with commas between them, as 3,3,0.6."
        ) from error
