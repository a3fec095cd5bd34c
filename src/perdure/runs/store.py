"""Store(root): one folder per finished unit of work.

    root/Hopper-v3/geometric/seed-0/           a finished unit: its files and unit.json
    root/.working/Hopper-v3~geometric~seed-0/  a unit in work; survives a kill
    root/.locks/                               who is at work on what
    root/.progress/, root/.failures/           last report and last error of units that are not finished

A unit appears under its key by one rename, so it is there with all its files or not at all.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.runs import lock
from perdure.runs.atomic_write import sync
from perdure.runs.errors import OtherSourceWarning, StoreError, UnitBusyError
from perdure.runs.identity import RECORD, Identity, check_key
from perdure.runs.source import source_digest

Config = Mapping[str, Any]


@dataclass
class Workspace:
    """The work folder of a unit, see `Store.workspace`."""

    folder: Path
    complete: bool = True
    """Whether the folder becomes the unit when the block ends."""


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
            StoreError: Bad key or config; the key is taken by another config or by a folder that is no unit; the unit
                is finished already; or the work folder was begun with another config.
        """
        unit = Identity.of(key, config)
        self._check_place(unit)
        self._hidden("locks")
        lock_path = self._lock_path(key)
        descriptor = lock.acquire(lock_path)
        if descriptor is None:
            raise UnitBusyError(f"{key!r} is being run by another process in {self.root}.")
        try:
            workspace = Workspace(self._begin_work(unit))
            yield workspace
            if workspace.complete:
                self._promote(workspace.folder, unit)
        finally:
            lock.release(descriptor, lock_path)

    def is_busy(self, key: str) -> bool:
        """Return whether a process is running the unit."""
        return lock.is_locked(self._lock_path(key))

    @contextmanager
    def exclusive(self, name: str, waiting: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Lock the whole store for one purpose; wait for another process that has locked it.

        Args:
            name: The purpose.
            waiting: Called once if there is another process.
        """
        path = self._hidden("locks") / f"all-{check_key(name)}"
        descriptor = lock.acquire(path)
        if descriptor is None:
            waiting()
            descriptor = lock.acquire(path, wait=True)
        assert descriptor is not None
        try:
            yield
        finally:
            lock.release(descriptor, path)

    def note_path(self, kind: str, key: str) -> Path:
        """Return where a note of some kind ("progress", "failures") about a unit lies; its folder may be missing."""
        return self.root / f".{kind}" / f"{_flat(check_key(key))}.json"

    def done(self, key: str, config: Config | None = None) -> bool:
        """Return whether the unit is finished.

        Raises:
            StoreError: It is, but with another config than the one given.
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
            StoreError: The unit is not finished, or has another config than the one given.
        """
        if not self.done(key, config):
            raise StoreError(f"{key!r} is not in {self.root}: it is not finished or was never begun.")
        return self._folder(key)

    def config(self, key: str) -> dict[str, Any]:
        """Return the config that a finished unit was written with (JSON values).

        Raises:
            StoreError: The unit is not finished, or its record is damaged.
        """
        return dict(Identity.read(self.get(key)).config)

    def warn_of_other_source(self, keys: Iterable[str]) -> None:
        """Warn when finished units among `keys` were made by another version of the source code.

        The warning is an `OtherSourceWarning`. The units are reused, because not every change of the code changes a
        result. Units without a recorded source are skipped.
        """
        folders = [self._folder(key) for key in keys if self.done(key)]
        others = [folder for folder in folders if set(Identity.read(folder).sources) - {source_digest()}]
        if others:
            warnings.warn(
                f"{len(others)} of {len(folders)} results were made by another version of perdure's source code and "
                f"are reused, such as {others[0]}. Remove a result's folder to compute it again.",
                OtherSourceWarning,
                stacklevel=2,
            )

    def keys(self, prefix: str = "") -> tuple[str, ...]:
        """Return the keys of all finished units, sorted; with `prefix`, of those under that part of the tree."""
        top = self._folder(prefix) if prefix else self.root
        found = []
        for folder, names, files in os.walk(top):
            names[:] = sorted(name for name in names if not name.startswith("."))
            if RECORD in files:
                found.append(Path(folder).relative_to(self.root).as_posix())
                names.clear()
        return tuple(sorted(found))

    def begun(self) -> tuple[str, ...]:
        """Return the keys of units that are not finished but have a work folder: at work, or interrupted."""
        return _noted(self.root / ".working", "")

    def noted(self, kind: str) -> tuple[str, ...]:
        """Return the keys of units about which there is a note of this kind, see `note_path`."""
        return _noted(self.root / f".{kind}", ".json")

    def _folder(self, key: str) -> Path:
        folder = self.root / check_key(key)
        if not folder.parent.resolve().is_relative_to(self.root.resolve()):
            raise StoreError(f"{key!r} leaves the store {self.root} through a symbolic link.")
        return folder

    def _hidden(self, name: str) -> Path:
        folder = self.root / f".{name}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _lock_path(self, key: str) -> Path:
        return self.root / ".locks" / f"work-{_flat(check_key(key))}"

    def _check_place(self, unit: Identity) -> None:
        """Refuse a unit whose key is taken by another config, lies inside a unit, or is a folder with units in it."""
        folder = self._folder(unit.key)
        if (folder / RECORD).is_file():
            Identity.read(folder).check_same(unit, str(folder))
            return
        for parent in folder.relative_to(self.root).parents:
            if (self.root / parent / RECORD).is_file():
                raise StoreError(f"{unit.key!r} lies inside the unit {parent.as_posix()!r} of {self.root}.")
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise StoreError(f"{folder} blocks the unit {unit.key!r}: the folder exists and is not a unit.")

    def _begin_work(self, unit: Identity) -> Path:
        if self.done(unit.key):
            raise StoreError(f"{unit.key!r} is finished already, in {self._folder(unit.key)}.")
        folder = self._hidden("working") / _flat(unit.key)
        if (folder / RECORD).is_file():
            Identity.read(folder).check_same(unit, str(folder))
        folder.mkdir(parents=True, exist_ok=True)
        unit.write(folder)
        return folder

    def _promote(self, folder: Path, unit: Identity) -> None:
        """Rename a complete folder to its key, unless the same unit got there first."""
        unit.write(folder)
        _sync_tree(folder)
        target = self._folder(unit.key)
        with lock.held(self._hidden("locks") / "promote"):
            self._check_place(unit)
            if (target / RECORD).is_file():
                return
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder, target)
        with suppress(OSError):
            sync(target.parent)


def _noted(folder: Path, suffix: str) -> tuple[str, ...]:
    names = os.listdir(folder) if folder.is_dir() else []
    return tuple(sorted(name.removesuffix(suffix).replace("~", "/") for name in names if name.endswith(suffix)))


def _flat(key: str) -> str:
    return key.replace("/", "~")  # "~" occurs in no key, so two keys never meet


def _sync_tree(folder: Path) -> None:
    for path, _, files in os.walk(folder):
        for name in files:
            file = Path(path) / name
            if file.is_file() and not file.is_symlink():
                sync(file)
        sync(Path(path))
