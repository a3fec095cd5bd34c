"""A small store: one folder per finished unit of work, written whole.

    store.py      Store(root): write, workspace, get, done, keys, remove
    identity.py   what makes a unit: a readable key and the SHA-256 of its config
    whole.py      write_whole: one file, either the old or the new, never half of it
    lock.py       advisory locks that the kernel lets go of when a process dies
    errors.py     StoreError

The package imports nothing else of perdure.
"""

from perdure.store.errors import StoreError
from perdure.store.identity import config_digest
from perdure.store.store import Store
from perdure.store.whole import write_whole

__all__ = ["Store", "StoreError", "config_digest", "write_whole"]
