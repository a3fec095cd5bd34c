"""Read members of an untrusted zip archive: sizes are checked before and during reading."""

from __future__ import annotations

import io
import lzma
import zipfile
import zlib

from perdure.policy.errors import PolicyFileError

MAX_MEMBERS = 10_000
"""A large network has a few hundred."""
_ENTRY = b"PK\x01\x02"
"""Begins each line of an archive's table of contents."""


class ZipMembers:
    """A zip archive in memory."""

    def __init__(self, data: bytes, what: str) -> None:
        """Read the table of contents.

        Args:
            data: The archive.
            what: Which file it is, for messages.

        Raises:
            PolicyFileError: If it is no zip archive, is damaged or has too many members.
        """
        self._what = what
        missing = f"{what} is not a zip archive, or its end is missing"
        if data.count(_ENTRY) > MAX_MEMBERS:
            raise PolicyFileError(f"{what} has more than {MAX_MEMBERS:,} members; it is not a model")
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, OverflowError, NotImplementedError, OSError):
            raise PolicyFileError(missing) from None
        self._members = {member.filename: member for member in self._archive.infolist()}
        if min((member.header_offset for member in self._members.values()), default=0):
            # A model contains archives. Where its own end is missing, `zipfile` finds the end of one of these.
            raise PolicyFileError(missing)

    @property
    def names(self) -> list[str]:
        """Names of all members."""
        return list(self._members)

    def read(self, name: str, limit: int) -> bytes:
        """Return a member's contents.

        Args:
            name: The member.
            limit: Largest size allowed, in bytes, unpacked.

        Raises:
            PolicyFileError: If it is missing, damaged or larger than the limit.
        """
        member = self._members.get(name)
        if member is None:
            raise PolicyFileError(f"{self._what} has no member {name!r}; it is not a model of Stable-Baselines3")
        if member.file_size > limit:
            raise PolicyFileError(
                f"{self._what}: {name!r} unpacks to {member.file_size:,} bytes; at most {limit:,} are read"
            )
        try:
            with self._archive.open(member) as file:
                data = file.read(limit + 1)
        except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, RuntimeError):
            # The last one includes encrypted members and unknown ways of packing.
            raise PolicyFileError(f"{self._what}: {name!r} is damaged") from None
        if len(data) != member.file_size:
            raise PolicyFileError(f"{self._what}: {name!r} is damaged: its size is not the one it declares")
        return data
