"""Units of work, and the store that keeps their results: one folder per finished unit.

A `Unit` is a key, a config and a function. Its result does not depend on who runs it or where. In a store there are

    root/Hopper-v3/geometric/seed-0/           a finished unit: its files and unit.json
    root/.working/Hopper-v3~geometric~seed-0/  a unit in work; survives a kill
    root/.locks/                               who is at work on what
    root/.progress/, root/.failures/           last report and last error of units that are not finished

A unit appears under its key by one rename, so it is there with all its files or not at all.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from perdure.errors import OtherSourceWarning, PerdureError, UnitBusyError, warn
from perdure.runs.files import acquire, held, release, sync
from perdure.runs.identity import RECORD, Identity, check_key, source_digest
from perdure.schema import LARGEST, Record, read_json

Config = Mapping[str, Any]
ReportCallback = Callable[..., None]
"""Called as ``report(done, total, **facts)``: work done and total work, in any unit; further numbers to show."""
AttemptResult = Literal["finished", "unfinished", "busy"]
REPORT_SECONDS = 0.5
"""Reports are written to disk this often at most."""


@dataclass(frozen=True)
class Unit:
    """A unit of work. It can be pickled, so that any process can run it."""

    key: str
    """Readable identity and place in the store, such as "Hopper-v3/geometric/seed-0"."""
    config: Mapping[str, Any]
    """Everything the result depends on; JSON. A finished unit of the same key and config is never run again."""
    function: str
    """``"package.module:name"`` of a function (`Work`, **arguments) -> bool | None. It leaves its result in the work
    folder. To be stopped and resumed it returns False whenever it has saved a checkpoint there: it is called again."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Keyword arguments of the function. No result depends on what is not in the config too."""
    after: tuple[str, ...] = ()
    """Keys of units that must be finished before this one begins."""
    size: float = 1.0
    """Amount of work relative to other units, for progress and remaining time."""
    cores: int = 1
    """Cores it can use."""


@dataclass(frozen=True)
class Work:
    """The argument of a unit's function."""

    folder: Path
    """Folder for its result; an interrupted attempt may have left files there."""
    threads: int
    """Cores it may use. No result may depend on it."""
    report: ReportCallback


def attempt(root: str | Path, unit: Unit, threads: int = 1, report: ReportCallback | None = None) -> AttemptResult:
    """Run a unit in this process, up to its end or its next checkpoint.

    Args:
        root: Folder of the store.
        unit: The unit; nothing happens if it is finished.
        threads: Cores it may use.
        report: Called with every report; by default reports go to a file that `read_progress` reads.

    Returns:
        "finished", "unfinished" (to be called again), or "busy": another process is running it.

    Raises:
        PerdureError: The unit cannot be stored.
        Exception: Whatever the unit's function raises.
    """
    store = Store(root)
    if store.done(unit.key, unit.config):
        return "finished"
    module, _, name = unit.function.partition(":")
    function = getattr(import_module(module), name)
    try:
        with store.workspace(unit.key, unit.config) as workspace:
            shown = report or _Reporter(store, unit.key)
            workspace.complete = function(Work(workspace.folder, threads, shown), **unit.arguments) is not False
    except UnitBusyError:
        return "busy"
    except PerdureError:
        if store.done(unit.key, unit.config):  # another process finished it in the meantime
            return "finished"
        raise
    if workspace.complete:
        return "finished"
    return "unfinished"


class Store:
    """Units of work in the folder `root`: each has a key and a config; its result is a folder, written atomically.

    The folder is made at the first write. Several processes may use one store; it has to lie on a POSIX file system
    that knows `flock`.
    """

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(os.path.abspath(root))  # a block may change the working directory
        source_digest()  # now, for long work outlives what is edited meanwhile

    @contextmanager
    def workspace(self, key: str, config: Config) -> Iterator[Workspace]:
        """Yield the work folder of a unit, with the files of an earlier, interrupted block.

        When the block ends without error the folder becomes the unit, unless the block set `complete` to False. When
        the block fails, or its process dies, the folder stays for the next attempt. One process at a time may hold it.

        Raises:
            UnitBusyError: Another process is at work on the unit.
            PerdureError: Bad key or config; the key is taken by another config or by a folder that is no unit; the unit
                is finished already; or the work folder was begun with another config.
        """
        unit = Identity.of(key, config)
        self._check_place(unit)
        descriptor = acquire(self._hidden("locks") / f"work-{_flat(key)}")
        if descriptor is None:
            raise UnitBusyError(f"{key!r} is being run by another process in {self.root}.")
        try:
            workspace = Workspace(self._begin_work(unit))
            yield workspace
            if workspace.complete:
                self._promote(workspace.folder, unit)
        finally:
            release(descriptor)

    def exclusive(self, name: str, waiting: Callable[[], None] = lambda: None) -> AbstractContextManager[None]:
        """Lock the whole store for the purpose `name` during a block; call `waiting` once if another process has it."""
        return held(self._hidden("locks") / f"all-{check_key(name)}", waiting)

    def note_path(self, kind: str, key: str) -> Path:
        """Return where a note of some kind ("progress", "failures") about a unit lies; its folder may be missing."""
        return self.root / f".{kind}" / f"{_flat(check_key(key))}.json"

    def done(self, key: str, config: Config | None = None) -> bool:
        """Return whether the unit is finished.

        Raises:
            PerdureError: It is, but with another config than the one given.
        """
        folder = self._folder(key)
        if not (folder / RECORD).is_file():
            return False
        if config is not None:
            self._check_place(Identity.of(key, config))
        return True

    def get(self, key: str, config: Config | None = None) -> Path:
        """Return the folder of a finished unit.

        Raises:
            PerdureError: The unit is not finished, or has another config than the one given.
        """
        if not self.done(key, config):
            raise PerdureError(f"{key!r} is not in {self.root}: it is not finished or was never begun.")
        return self._folder(key)

    def config(self, key: str) -> dict[str, Any]:
        """Return the config that a finished unit was written with (JSON values).

        Raises:
            PerdureError: The unit is not finished, or its record is damaged.
        """
        return dict(Identity.read(self.get(key)).config)

    def warn_of_other_source(self, keys: Iterable[str]) -> None:
        """Warn when results among `keys`, finished or begun, were made by another version of the source code.

        The warning is an `OtherSourceWarning`. The units are reused, because not every change of the code changes a
        result. Units without a recorded source are skipped.
        """
        folders = []
        for key in keys:
            places = (self._folder(key), self.root / ".working" / _flat(key))
            folders += [place for place in places if (place / RECORD).is_file()]
        others = [folder for folder in folders if set(Identity.read(folder).sources) - {source_digest()}]
        if others:
            warn(
                f"{len(others)} of {len(folders)} results were made by another version of perdure's source code and "
                f"are reused, such as {others[0]}. Remove a result's folder to compute it again.",
                OtherSourceWarning,
            )

    def keys(self, prefix: str = "") -> tuple[str, ...]:
        """Return the keys of all finished units, sorted; with `prefix`, of those under that part of the tree."""
        top = self.root
        if prefix:
            top = self._folder(prefix)
        found = []
        for folder, names, files in os.walk(top):
            names[:] = sorted(name for name in names if not name.startswith("."))
            if RECORD in files:
                found.append(Path(folder).relative_to(self.root).as_posix())
                names.clear()
        return tuple(sorted(found))

    def work_folder(self, key: str) -> Path:
        """Return the folder in which an unfinished unit keeps its files between attempts; it may not exist."""
        return self.root / ".working" / _flat(key)

    def _folder(self, key: str) -> Path:
        folder = self.root / check_key(key)
        if not folder.parent.resolve().is_relative_to(self.root.resolve()):
            raise PerdureError(f"{key!r} leaves the store {self.root} through a symbolic link.")
        return folder

    def _hidden(self, name: str) -> Path:
        folder = self.root / f".{name}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _check_place(self, unit: Identity) -> None:
        """Refuse a unit whose key is taken by another config, lies inside a unit, or is a folder with units in it."""
        folder = self._folder(unit.key)
        if (folder / RECORD).is_file():
            Identity.read(folder).check_same(unit, str(folder))
            return
        for parent in folder.relative_to(self.root).parents:
            if (self.root / parent / RECORD).is_file():
                raise PerdureError(f"{unit.key!r} lies inside the unit {parent.as_posix()!r} of {self.root}.")
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise PerdureError(f"{folder} blocks the unit {unit.key!r}: the folder exists and is not a unit.")

    def _begin_work(self, unit: Identity) -> Path:
        if self.done(unit.key):
            raise PerdureError(f"{unit.key!r} is finished already, in {self._folder(unit.key)}.")
        folder = self.work_folder(unit.key)
        folder.mkdir(parents=True, exist_ok=True)
        if any(each.name != RECORD and not each.name.startswith(".") for each in folder.iterdir()):
            Identity.read(folder).check_same(unit, str(folder))
        else:  # an attempt that left nothing blocks nobody, and made nothing
            (folder / RECORD).unlink(missing_ok=True)
        unit.write(folder)
        return folder

    def _promote(self, folder: Path, unit: Identity) -> None:
        """Rename a complete folder to its key, unless the same unit got there first."""
        unit.write(folder)
        _sync_tree(folder)
        target = self._folder(unit.key)
        with held(self._hidden("locks") / "promote"):
            self._check_place(unit)
            if (target / RECORD).is_file():
                return
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder, target)
        with suppress(OSError):
            sync(target.parent)


@dataclass
class Workspace:
    """The work folder of a unit, see `Store.workspace`."""

    folder: Path
    complete: bool = True
    """Whether the folder becomes the unit when the block ends."""


def _flat(key: str) -> str:
    return key.replace("/", "~")  # "~" occurs in no key, so two keys never meet


def _sync_tree(folder: Path) -> None:
    for path, _, files in os.walk(folder):
        for name in files:
            file = Path(path) / name
            if file.is_file() and not file.is_symlink():
                sync(file)
        sync(Path(path))


class _Progress(Record, frozen=True):
    """A report on disk."""

    done: Annotated[float, Meta(ge=0, le=LARGEST)]
    total: Annotated[float, Meta(ge=0, le=LARGEST)]
    facts: dict[str, float]


class _Reporter:
    """Writes reports to the store, where any process can read them."""

    def __init__(self, store: Store, key: str) -> None:
        self._path = store.note_path("progress", key)
        self._last = 0.0

    def __call__(self, done: float, total: float, **facts: float) -> None:
        now = time.monotonic()
        if now - self._last < REPORT_SECONDS and done < total:
            return
        self._last = now
        temporary = self._path.with_suffix(f".{os.getpid()}")
        with suppress(OSError):  # progress is not worth failing for
            self._path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_text(json.dumps({"done": done, "total": total, "facts": facts}))
            os.replace(temporary, self._path)


def read_progress(store: Store, key: str) -> tuple[float, float, dict[str, float]]:
    """Return (done, total, facts) of the unit's last report, (0, 1, {}) before the first."""
    with suppress(OSError, PerdureError):
        record: _Progress = read_json(store.note_path("progress", key).read_bytes(), _Progress)
        return record.done, record.total, record.facts
    return 0.0, 1.0, {}
