"""Changes of valid files: of bytes, of JSON values, of arrays, of cells."""

import copy
import math

import numpy as np

ODD = (
    *(None, True, False, 0, -1, 1, 2, 7, 99, 2**31, 2**53, 2**63 - 1, 2**63, -(2**63) - 1, 10**400, 0.5, -0.0),
    *(1e-300, 1e308, -1e308, math.inf, -math.inf, math.nan, "", "x", "inf", "nan", "x" * 3000, "\x1b[2J", "\ud800"),
    *("../../x", "\u202e", "0", [], {}, [[]], [None], {"": None}, [0.0] * 9, {"name": "constant", "steps": 1}),
)


def bytes_of(rng, whole):
    """A file with bytes changed, cut, doubled or put elsewhere."""
    data = bytearray(whole)
    for _ in range(rng.choice((1, 1, 1, 2, 5, 50))):
        at, kind = rng.randrange(len(data)), rng.randrange(8)
        if kind < 3:
            data[at] = rng.randrange(256)
        elif kind == 3:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 4:
            del data[at : at + rng.choice((1, 4, 100))]
        elif kind == 5:
            data[at:at] = rng.randbytes(rng.choice((1, 4, 100)))
        elif kind == 6:
            data[at : at + 8] = rng.choice((b"\0" * 8, b"\xff" * 8, (2**31).to_bytes(8, "little")))
        else:
            data[at:] = data[at : at + rng.randrange(200)]
        if not data:
            return b""
    return bytes(data)


DEPTHS = (5, 50, 500)


def nested(rng, depths=DEPTHS):
    """A list that is nested deep."""
    value = 0
    for _ in range(rng.choice(depths)):
        value = [value]
    return value


def json_value(rng, value, times=None, depths=DEPTHS):
    """A JSON value changed in some places: replaced, removed, doubled, exchanged, added to."""
    value = copy.deepcopy(value)
    for _ in range(times or rng.choice((1, 1, 1, 2, 3))):
        spots = list(_spots(value))
        if not spots:
            return value
        holder, key = rng.choice(spots)
        kind = rng.randrange(10)
        if kind < 6:
            holder[key] = copy.deepcopy(rng.choice(ODD)) if rng.random() < 0.95 else nested(rng, depths)
        elif kind == 6:
            del holder[key]
        elif kind == 7 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif kind == 7:
            holder[f"{key}x"] = holder[key]
        elif kind == 8:
            other, place = rng.choice(spots)
            holder[key], other[place] = copy.deepcopy(other[place]), copy.deepcopy(holder[key])
        elif isinstance(holder[key], float) or (type(holder[key]) is int and abs(holder[key]) < 2**64):
            holder[key] = holder[key] * rng.choice((-1, 0, 0.5, 2, 10, 1e9)) + rng.choice((0, 1, -1))
    return value


def _spots(value):
    """Every (container, key) in a JSON value."""
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield value, key
            yield from _spots(part)


def array(rng, values):
    """An array with numbers, type or shape changed."""
    values = values.copy()
    kind = rng.randrange(6)
    if kind < 3 and values.size:
        flat = values.reshape(-1)
        odd = (0, 1, -1, math.nan, math.inf, -math.inf, 1e30, 3e38, -3e38, 1e-40)
        number = rng.choice(odd) if values.dtype.kind == "f" else rng.choice((0, 1, -1, 127))
        flat[rng.randrange(flat.size) :][: rng.choice((1, 3, flat.size))] = number
    elif kind == 3:
        with np.errstate(all="ignore"):
            values = np.nan_to_num(values).astype(rng.choice(("f2", "f4", "f8", "i4", "i8", "u1", "b1")))
    elif kind == 4:
        values = values.reshape(rng.choice(((-1,), (1, *values.shape), (*values.shape, 1))))
    else:
        values = values[: rng.randrange(len(values) + 1)] if values.ndim else values.reshape(1)
    return np.ascontiguousarray(values)
