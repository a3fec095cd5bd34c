"""A small store: one folder per finished unit of work, written whole.

    store.py      Store(root): write, workspace, get, done, keys, remove, warn_of_other_source
    identity.py   what makes a unit: a readable key and the SHA-256 of its config
    source.py     which source code made a unit, so that old results are told from new ones
    whole.py      write_whole: one file, either the old or the new, never half of it
    lock.py       advisory locks that the kernel lets go of when a process dies
    errors.py     StoreError, OtherSourceWarning

The package imports nothing else of perdure.
"""

from perdure.store.errors import OtherSourceWarning, StoreError
from perdure.store.identity import config_digest
from perdure.store.store import Store
from perdure.store.whole import write_whole

__all__ = ["OtherSourceWarning", "Store", "StoreError", "config_digest", "write_whole"]
