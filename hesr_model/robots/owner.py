"""Whose a robot's models are: what FMUs made of them say of author, copyright and licence."""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import ValidationError, model_serializer

from hesr_model.errors import ArtifactError
from hesr_model.support.config import Config, PrintableName


class Owner(Config):
    """Author, copyright and licence of models, as far as they are known.

    Attributes
    ----------
    author : person or organisation.
    copyright : as "Copyright (c) 2026 A Company".
    license : name or text of the licence, as "Apache-2.0" or "All rights reserved".
    """

    author: PrintableName = ""
    copyright: PrintableName = ""
    license: PrintableName = ""

    @property
    def known(self) -> dict[str, str]:
        """What is known, by name."""
        found = {name: str(getattr(self, name)) for name in type(self).model_fields}
        return {name: text for name, text in found.items() if text}

    @model_serializer(mode="plain")
    def _as_written(self) -> dict[str, str]:
        return self.known

    @classmethod
    def of(cls, provenance: Mapping[str, Any]) -> Self:
        """Return the owner that a model's provenance names ("owner"), or one that is not known.

        Raises
        ------
        ArtifactError
            If it is not a table of these texts.
        """
        found = provenance.get("owner", {})
        try:
            return cls.model_validate(found)
        except ValidationError as error:
            raise ArtifactError(
                f"the provenance's 'owner' is {found!r}; needed are texts for author, copyright "
                "and license, of printable characters."
            ) from error


OURS = Owner(
    author="The HESR authors", copyright="Copyright (c) 2026 The HESR authors", license="MIT"
)
"""Of FMUs that hold nothing but code of HESR."""
