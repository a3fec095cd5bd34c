"""Readers of contracts: which formats of files say how a policy is deployed.

A reader is a subclass of `ContractReader`, found as soon as it is defined, also in another package (see
`perdure.registry`). perdure's own format is YAML with the fields of `Contract`.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from msgspec.structs import replace

from perdure.errors import DetailedError, PerdureError, did_you_mean
from perdure.policy.onnx import metadata
from perdure.registry import Registered
from perdure.robots.contract import (
    PER_JOINT,
    REQUIRED,
    Contract,
    HeldJoints,
    RandomCommands,
    Term,
    make_contract,
    model_path,
)
from perdure.robots.mjcf import read_model
from perdure.runs import read_bounded
from perdure.schema import checked

MODEL_OPTION = ",model="
"""What separates a file from the MJCF of its robot in the name of an environment."""
MOST_NODES = 10_000
"""Values that aliases in a deployment file may repeat."""


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

        A reader of files that name no model is a `DeploymentReader`, which gets it.

        Raises:
            PerdureError: If a field is missing, unknown or does not fit the joints. The file is named for it.
        """


@dataclass(frozen=True)
class Reading:
    """What a file says of a contract."""

    fields: dict[str, Any] = field(default_factory=dict)
    """Values of fields of the contract."""
    missing: dict[str, str] = field(default_factory=dict)
    """Fields that the file does not say, or says in a way that a contract cannot hold, and why."""


class DeploymentReader(ContractReader):
    """Reads files that come with a policy and leave the robot's model to the user.

    `--env deploy.yaml --model g1.xml` names it. What the file does not say is named, never guessed; `perdure robot
    init` writes a contract with what it says, and with lines to complete.
    """

    @abstractmethod
    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """Return what a file says.

        Args:
            path: The file.
            robot: What `perdure.robots.mjcf.read_model` says of the robot's model.

        Raises:
            PerdureError: If the file is not as its authors write it.
        """

    def named_model(self, path: Path) -> Path | None:
        """Return the MJCF that a file names, if it is there; None if it names none."""
        return None

    def model_of(self, path: Path, model: str | None) -> Path:
        """Return the MJCF that the user names, else the one that the file names; PerdureError if there is none."""
        if model is not None:
            return model_path(model)
        found = self.named_model(path)
        if found is None:
            raise PerdureError("it names no model of the robot: add --model robot.xml")
        return found

    def read(self, path: Path, model: str | None = None) -> Contract:
        """Return the contract in a file, for the MJCF of a robot; see `ContractReader.read`.

        Raises:
            PerdureError: If no model is known, or the file does not say all that a contract needs: a line for each.
        """
        where = self.model_of(path, model)
        robot = read_model(where)
        reading = self.reading(path, robot)
        fields = {"time_step": robot["time_step"], **reading.fields, "model": str(where.resolve())}
        missing = dict(reading.missing)
        for name in REQUIRED:
            if fields.get(name) is None:
                missing.setdefault(name, "the file does not say it")
        if missing:
            lines = [f"  {name}: {reason}" for name, reason in missing.items()]
            writes = f"`perdure robot init {path} --model {model or where}` writes a contract with lines to complete"
            raise DetailedError("\n".join(["not all that a contract needs is there:", *lines, writes]))
        return make_contract(checked(fields, Contract))


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
        for place, table in enumerate(_tables(values.get("held"))):
            refuse_unknown(table, HeldJoints, f"held[{place}]: ")
        for table in _tables([values.get("random")]):
            refuse_unknown(table, RandomCommands, "random: ")
        named = values.get("metadata")
        found: dict[str, Any] = {}
        if named:
            found = from_metadata(metadata(path.parent / str(named)))
        return make_contract(checked({**found, **values}, Contract), path.parent)


def read_contract(name: str | Path) -> Contract:
    """Return the contract in a file; PerdureError if a field is missing, unknown or does not fit the joints.

    Args:
        name: The file. One that names no model is followed by it: `deploy.yaml,model=g1.xml`.
    """
    path, model = split_name(name)
    if not path.is_file():
        raise PerdureError(f"there is no contract {path}")
    reader = find_reader(path)
    try:
        if isinstance(reader, DeploymentReader):
            return reader.read(path, model)
        contract = reader.read(path)
    except PerdureError as error:
        raise type(error)(f"{path}: {error}") from None
    if model is not None:
        return replace(contract, model=str(model_path(model)))
    return contract


def split_name(name: str | Path) -> tuple[Path, str | None]:
    """Return the file and the model that the name of a contract means; the model is None if it names none."""
    file, _, model = str(name).partition(MODEL_OPTION)
    if not model:
        return Path(file), None
    return Path(file), model


def with_model(name: str, model: str) -> str:
    """Return the name of a contract in a file with this MJCF of the robot."""
    return f"{name}{MODEL_OPTION}{model}"


def suffixes() -> tuple[str, ...]:
    """Return how the names of contracts end."""
    found: list[str] = []
    for kind in ContractReader.kinds().values():
        found += kind.suffixes
    return tuple(dict.fromkeys(found))


def find_reader(path: Path) -> ContractReader:
    """Return the reader of a file: the first that recognizes it, else that of perdure's own format."""
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
    """Return YAML as plain values; aliases are refused where they stand for much, since a few may be gigabytes.

    Args:
        data: The text.
        foreign: The file was written by a program: a few aliases are allowed, and what is tagged with a class of
            Python is read as the plain values that it is written with. Nothing of the class is imported.
    """
    import yaml

    kind = yaml.SafeLoader
    most = 0
    if foreign:
        kind = _foreign_loader()
        most = MOST_NODES
    try:
        loader = kind(data)
        node = loader.get_single_node()
        repeated = _nodes(node, {}) - _nodes(node, {}, once=True)
        if repeated > most:
            raise PerdureError("aliases of YAML (*name) are not read: write them out")
        values = None
        if node is not None:
            values = loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, PerdureError):
            raise
        raise PerdureError(f"it is no YAML: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(values, dict):
        raise PerdureError("it must hold a table of fields, such as model: robot.xml")
    return values


def _nodes(node: Any, known: dict[int, int], once: bool = False) -> int:
    """Return how many values are below a node of YAML, with those that aliases repeat; without them if `once`."""
    if id(node) in known:
        if once:
            return 0
        return known[id(node)]
    known[id(node)] = 10 * MOST_NODES  # of an alias inside of what it stands for
    count = 1
    if isinstance(getattr(node, "value", None), list):
        for each in node.value:
            parts = each if isinstance(each, tuple) else (each,)
            count += sum(_nodes(part, known, once) for part in parts)
    known[id(node)] = count
    return count


def _foreign_loader() -> Any:
    """Return a subclass of YAML's safe loader that reads a value of any unknown tag without it."""
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
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
