"""Reader of the YAML that LEAPP, the exporter of newer versions of Isaac Lab, writes beside its graph of models.

Such a graph takes measurements and gives joint targets: the observations, their scales and the default pose are inside
of it. So a contract gets the names of the joints, and the rest is named. Source: the documentation of LEAPP (Getting
Started; Semantic Data Annotation).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from perdure.robots.deployment import as_written_by, foreign_yaml, top_level_names
from perdure.robots.readers import DeploymentReader, Reading

TARGETS = "target/joint/position"
"""Kind of the output that drives the joints."""


class LeappGraph(DeploymentReader):
    """See `words`."""

    name = "leapp"
    words = "YAML of a graph that LEAPP exported: the names of the joints"
    suffixes = (".yaml", ".yml")

    def recognizes(self, path: Path) -> bool:
        """See `ContractReader.recognizes`."""
        return {"models", "pipeline"} <= top_level_names(path)

    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """See `DeploymentReader.reading`."""
        with as_written_by("LEAPP"):
            return _reading(foreign_yaml(path)["models"])


def _reading(models: Mapping[str, Any]) -> Reading:
    measured = [f"{each['name']} ({each['kind']})" for each in _tensors(models, "inputs") if each.get("kind")]
    inside = "the graph computes it itself; see the environment that it was exported from"
    missing = dict.fromkeys(("default_pose", "stiffness", "damping", "action_scale", "decimation"), inside)
    missing["observations"] = f"{inside}; it takes {', '.join(measured) or 'inputs without a kind'}"
    fields: dict[str, Any] = {}
    targets = [each for each in _tensors(models, "outputs") if each.get("kind") == TARGETS and "element_names" in each]
    if len(targets) == 1:
        fields["joints"] = [str(name) for name in targets[0]["element_names"][-1]]
    else:
        missing["joints"] = f"{len(targets)} outputs of the graph are named joint targets ({TARGETS})"
    return Reading(fields, missing)


def _tensors(models: Mapping[str, Any], side: str) -> Iterator[Mapping[str, Any]]:
    """Yield the inputs or outputs of all models."""
    for model in models.values():
        yield from model[side]
