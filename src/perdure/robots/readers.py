"""Readers of contracts: which formats of files say how a policy is deployed.

A reader is a subclass of `ContractReader`, found as soon as it is defined, also in another package (see
`perdure.registry`). perdure's own format is YAML with the fields of `Contract`.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from perdure.errors import PerdureError, did_you_mean
from perdure.policy.onnx import metadata
from perdure.registry import Registered
from perdure.robots.contract import PER_JOINT, Contract, RandomCommands, Term, make_contract
from perdure.runs import read_bounded
from perdure.schema import checked


class ContractReader(Registered):
    """Reads one format of files as the contract of a robot."""

    words: ClassVar[str]
    """Which files it reads."""
    suffixes: ClassVar[tuple[str, ...]]
    """How names of such files end, such as ".yaml"; such a name is that of an environment and of a task."""

    def recognizes(self, path: Path) -> bool:
        """Return whether a file whose name has one of the suffixes is of this format."""
        return True

    @abstractmethod
    def read(self, path: Path) -> Contract:
        """Return the contract in a file, as `make_contract` makes it.

        Raises:
            PerdureError: If a field is missing, unknown or does not fit the joints. The file is named for it.
        """


class YamlContract(ContractReader):
    """See `words`. It reads every file that no other reader recognizes."""

    name = "perdure"
    words = "YAML with the fields of perdure.robots.contract.Contract"
    suffixes = (".yaml", ".yml")

    def read(self, path: Path) -> Contract:
        """See `ContractReader.read`; metadata of a policy fill what the file leaves out."""
        values = parse_yaml(read_bounded(path, 1_000_000))
        refuse_unknown(values, Contract, "")
        for place, term in enumerate(_tables(values.get("observations"))):
            refuse_unknown(term, Term, f"observations[{place}]: ")
        for table in _tables([values.get("random")]):
            refuse_unknown(table, RandomCommands, "random: ")
        named = values.get("metadata")
        found = {}
        if named:
            found = from_metadata(metadata(path.parent / str(named)))
        return make_contract(checked({**found, **values}, Contract), path.parent)


def read_contract(path: str | Path) -> Contract:
    """Return the contract in a file; PerdureError if a field is missing, unknown or does not fit the joints."""
    where = Path(path)
    if not where.is_file():
        raise PerdureError(f"there is no contract {where}")
    try:
        return _reader(where).read(where)
    except PerdureError as error:
        raise PerdureError(f"{where}: {error}") from None


def suffixes() -> tuple[str, ...]:
    """Return how the names of contracts end."""
    found: list[str] = []
    for kind in ContractReader.kinds().values():
        found += kind.suffixes
    return tuple(found)


def _reader(path: Path) -> ContractReader:
    """Return the reader of a file."""
    for kind in ContractReader.kinds().values():
        if kind is not YamlContract and path.suffix in kind.suffixes and kind().recognizes(path):
            return kind()
    return YamlContract()


def refuse_unknown(values: dict[str, Any], kind: type, where: str) -> None:
    """Raise PerdureError, with `where` and the nearest name, if a table has a field that is not declared."""
    names = kind.__struct_fields__  # type: ignore[attr-defined]
    for name in values:
        if name not in names:
            hint = did_you_mean(name, names) or f"; the fields are {', '.join(names)}"
            raise PerdureError(f"{where}there is no field {str(name)[:80]!r}{hint}")


def _tables(values: Any) -> list[dict[str, Any]]:
    """Return the tables in a list."""
    if not isinstance(values, list):
        return []
    return [each for each in values if isinstance(each, dict)]


def parse_yaml(data: bytes, foreign: bool = False) -> dict[str, Any]:
    """Return YAML as plain values; aliases are refused, since a few of them may stand for gigabytes.

    Args:
        data: The text.
        foreign: Read what is tagged with a class of Python as the plain values that it is written with. Nothing of the
            class is imported.
    """
    import yaml

    loader = yaml.SafeLoader
    if foreign:
        loader = _foreign_loader()
    try:
        if any(isinstance(each, yaml.AliasEvent) for each in yaml.parse(data, yaml.SafeLoader)):
            raise PerdureError("aliases of YAML (*name) are not read: write them out")
        values = yaml.load(data, loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PerdureError(f"it is no YAML: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(values, dict):
        raise PerdureError("it must hold a table of fields, such as model: robot.xml")
    return values


def _foreign_loader() -> Any:
    """Return a subclass of YAML's safe loader that reads a value of any unknown tag without it."""
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """See `parse_yaml`."""

    def plain(loader: Any, suffix: str, node: Any) -> Any:
        if isinstance(node, yaml.MappingNode):
            return loader.construct_mapping(node, deep=True)
        if isinstance(node, yaml.SequenceNode):
            return loader.construct_sequence(node, deep=True)
        return loader.construct_scalar(node)

    Loader.add_multi_constructor("", plain)
    return Loader


NAMES = {
    "joint_names": "joints",
    "joint_stiffness": "stiffness",
    "joint_damping": "damping",
    "default_joint_pos": "default_pose",
    "action_scale": "action_scale",
    "observation_names": "observations",
    "dof_names": "joints",
    "kp": "stiffness",
    "kd": "damping",
}
"""Names in the metadata of mjlab and of holosoma to the fields that they fill."""


def from_metadata(notes: Mapping[str, str]) -> dict[str, Any]:
    """Return the fields of a contract that a policy's metadata hold, as mjlab's comma-separated text or as JSON."""
    try:
        found: dict[str, Any] = {NAMES[name]: _words(text) for name, text in notes.items() if name in NAMES and text}
        for field in set(PER_JOINT) & found.keys():
            found[field] = _alone([float(each) for each in found[field]])
        terms = [{"name": name} for name in found.get("observations", ())]
        for name, field, convert in (
            ("observation_terms_scale", "scale", float),
            ("observation_terms_clip", "clip", float),
            ("observation_terms_history_length", "history", lambda text: int(float(text))),
        ):
            for term, text in zip(terms, _words(notes.get(name, "")), strict=False):
                parts = [convert(each) for each in text.split(";") if each]
                if parts:
                    term[field] = _alone(parts)
    except (ValueError, IndexError, OverflowError, RecursionError) as error:
        raise PerdureError(f"the policy's metadata cannot be read: {error}") from None
    if terms:
        found["observations"] = terms
    return found


def _alone(numbers: list[Any]) -> Any:
    """Return several numbers as they are, and one without its list; IndexError if there is none."""
    if len(numbers) > 1:
        return numbers
    return numbers[0]


def _words(text: str) -> list[str]:
    values = text.split(",")
    if text.startswith("["):
        values = json.loads(text)
    return [str(each).strip() for each in values]
