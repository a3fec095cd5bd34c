"""Store(root): one folder per finished unit of work.

    root/Hopper-v3/geometric/seed-0/           a finished unit: its files and unit.json
    root/.working/Hopper-v3~geometric~seed-0/  a unit that checkpoints inside and survives being killed
    root/.writing/3f9a0c51/                    a unit being written in one go; dropped when its writer dies
    root/.locks/                               who is alive

A unit appears under its key by one rename, so it is there with all its files or not at all.
"""

from __future__ import annotations

import os
import secrets
import shutil
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from perdure.store import lock
from perdure.store.errors import OtherSourceWarning, StoreError
from perdure.store.identity import RECORD, Identity, check_key
from perdure.store.source import source_digest
from perdure.store.whole import sync_file, sync_folder

Config = Mapping[str, Any]


class Store:
    """Units of work in the folder `root`: a key and a config in, a folder written whole out.

    The folder is made at the first write. Several processes may use one store; it has to lie on a POSIX file system
    that knows `flock`.
    """

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(os.path.abspath(root))  # a block may change the working directory
        source_digest()  # now, for long work outlives what is edited meanwhile

    @contextmanager
    def write(self, key: str, config: Config) -> Iterator[Path]:
        """Give an empty temporary folder and make it the unit when the block ends without error.

        When the block fails, or its process dies, nothing of it stays. When another process finished the same unit
        meanwhile, the first one is kept and this one dropped: `get(key)` afterwards names the folder that counts.

        Raises:
            StoreError: Bad key or config, or the key is taken by another config or by a folder that is no unit.
        """
        unit = Identity.of(key, config)
        self._check_place(unit)
        self.clean()
        folder, lock_path, descriptor = self._new_temporary()
        try:
            yield folder
            self._promote(folder, unit)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            lock.release(descriptor, lock_path)

    @contextmanager
    def workspace(self, key: str, config: Config) -> Iterator[Path]:
        """Give the work folder of a unit, with whatever an earlier, interrupted block left in it.

        When the block ends without error the folder becomes the unit; when it fails, or its process dies, the folder
        stays for the next attempt. One process at a time may hold it.

        Raises:
            StoreError: As `write`; also when another process is at work on the unit, when the unit is finished
                already, or when the work folder was begun with another config.
        """
        unit = Identity.of(key, config)
        self._check_place(unit)
        lock_path = self._hidden("locks") / f"work-{_flat(key)}"
        descriptor = lock.acquire(lock_path)
        if descriptor is None:
            raise StoreError(f"{key!r} is being worked on by another process in {self.root}.")
        try:
            folder = self._begin_work(unit)
            yield folder
            self._promote(folder, unit)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            lock.release(descriptor, lock_path)

    def done(self, key: str, config: Config | None = None) -> bool:
        """Say whether the unit is finished.

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
        """Warn (`OtherSourceWarning`) when other source code than this had a hand in finished units among `keys`.

        They still count: whether a change of the code changes a result, only who made it knows. Units that do not say
        what made them are passed over.
        """
        folders = [self._folder(key) for key in keys if self.done(key)]
        others = [folder for folder in folders if set(Identity.read(folder).sources) - {source_digest()}]
        if others:
            warnings.warn(
                f"{len(others)} of {len(folders)} finished units were made by other source code of perdure and are "
                f"taken as they are, first of all {others[0]}. Remove those that shall be made anew.",
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

    def remove(self, key: str) -> None:
        """Remove a finished unit. It vanishes by one rename, so nobody sees half of it.

        Raises:
            StoreError: The unit is not finished.
        """
        folder = self.get(key)
        temporary, lock_path, descriptor = self._new_temporary()
        try:
            os.replace(folder, temporary)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            lock.release(descriptor, lock_path)

    def clean(self) -> None:
        """Remove what dead writers left in `.writing`. Living writers hold a lock and are left alone."""
        for lock_path in list((self.root / ".locks").glob("write-*")):
            descriptor = lock.acquire(lock_path)
            if descriptor is not None:
                shutil.rmtree(self.root / ".writing" / lock_path.name.removeprefix("write-"), ignore_errors=True)
                lock.release(descriptor, lock_path)

    def _folder(self, key: str) -> Path:
        folder = self.root / check_key(key)
        if not folder.parent.resolve().is_relative_to(self.root.resolve()):
            raise StoreError(f"{key!r} leaves the store {self.root} through a symbolic link.")
        return folder

    def _hidden(self, name: str) -> Path:
        folder = self.root / f".{name}"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _new_temporary(self) -> tuple[Path, Path, int]:
        """Make an empty folder in `.writing`, locked before it exists so that `clean` never takes it for dead."""
        token = secrets.token_hex(8)
        lock_path = self._hidden("locks") / f"write-{token}"
        descriptor = lock.acquire(lock_path, wait=True)
        assert descriptor is not None
        folder = self._hidden("writing") / token
        folder.mkdir()
        return folder, lock_path, descriptor

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
            raise StoreError(f"{folder} is in the way of the unit {unit.key!r}: it exists and is not a unit.")

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
            sync_folder(target.parent)


def _flat(key: str) -> str:
    return key.replace("/", "~")  # "~" occurs in no key, so two keys never meet


def _sync_tree(folder: Path) -> None:
    for path, _, files in os.walk(folder):
        for name in files:
            file = Path(path) / name
            if file.is_file() and not file.is_symlink():
                sync_file(file)
        sync_folder(Path(path))
