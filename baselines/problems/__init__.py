"""Published problems: fits with data and optima, and systems of residuals."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from baselines.problems.published_fits import (
        PublishedFit,
        load_published,
        published_fit,
        published_names,
        zero_residuals,
    )
    from baselines.problems.published_model import PublishedModel
    from baselines.problems.residual_systems import ResidualSystem

__all__ = [
    "PublishedFit", "PublishedModel", "ResidualSystem", "load_published", "published_fit",
    "published_names", "zero_residuals",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
