"""Types of the variables of a model description, the same in both versions of FMI."""

from fmpy.model_description import ModelVariable


def is_boolean(variable: ModelVariable) -> bool:
    return bool(variable.type == "Boolean")


def is_integer(variable: ModelVariable) -> bool:
    return variable.type in ("Integer", "Int32")


def is_real(variable: ModelVariable) -> bool:
    return variable.type in ("Real", "Float64")
