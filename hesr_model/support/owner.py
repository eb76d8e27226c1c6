"""Owner of a model or an FMU: author, copyright and licence."""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import ValidationError, model_serializer

from hesr_model.errors import ArtifactError
from hesr_model.support.typed_files import Config, PrintableName


class Owner(Config):
    """Author, copyright ("Copyright (c) 2026 A Company") and licence ("Apache-2.0")."""

    author: PrintableName = ""
    copyright: PrintableName = ""
    license: PrintableName = ""

    @property
    def known(self) -> dict[str, str]:
        """Known entries by name."""
        return {name: text for name, text in self if text}

    @model_serializer(mode="plain")
    def _as_written(self) -> dict[str, str]:
        return self.known

    @classmethod
    def from_provenance(cls, provenance: Mapping[str, Any]) -> Self:
        """Return the owner of a provenance; raises ArtifactError."""
        entries = provenance.get("owner", {})
        try:
            return cls.model_validate(entries)
        except ValidationError as error:
            raise ArtifactError(
                f"the provenance's 'owner' is {entries!r}; expected texts for author, copyright "
                "and license, of printable characters.",
                code="owner.texts",
                key="owner",
            ) from error


OURS = Owner(
    author="The HESR authors", copyright="Copyright (c) 2026 The HESR authors", license="MIT"
)
"""Owner of FMUs with code of HESR only."""
