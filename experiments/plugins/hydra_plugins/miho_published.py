"""Published problems as options of the group `problem`: a source of configurations for Hydra.

Hydra imports this file at the start of every command. The table is read at its first use.
"""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import OmegaConf

GROUP = "problem"


class PublishedProblems(ConfigSource):
    """The rows of `conf/problem/published.csv`; see `experiments.app.options`."""

    @staticmethod
    def scheme() -> str:
        """Return the beginning of the address in the search path."""
        return "published"

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the configuration of a problem, which replaces nodes of the whole one."""
        from experiments.app.options import settings_of

        config = OmegaConf.create(settings_of(_name(config_path)))
        return ConfigResult(self.provider, self.full_path(), config, {"package": "_global_"})

    def available(self) -> bool:
        """Return true, because the table is part of the repository."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Return whether a path is the only group."""
        return config_path.strip("/") == GROUP

    def is_config(self, config_path: str) -> bool:
        """Return whether a path is a problem of the table."""
        from experiments.app.options import recorded

        return config_path.startswith(f"{GROUP}/") and _name(config_path) in recorded()

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Return the names of the problems."""
        from experiments.app.options import recorded

        return sorted(recorded()) if self.is_group(config_path) else []


class PublishedSearchPath(SearchPathPlugin):
    """Add the published problems to the search path, after the files."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the source."""
        search_path.append("miho", "published://")


def _name(config_path: str) -> str:
    return config_path.removeprefix(f"{GROUP}/").removesuffix(".yaml")
