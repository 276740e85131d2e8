"""Seeded damage to files: bytes, words and numbers of a text, nodes of a JSON value, elements of XML.

Every function takes a generator and returns what became of its input; the same seed does the same damage.
"""

from __future__ import annotations

import copy
import io
import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np

_WORD = 4
_NUMBERS = (
    "nan", "inf", "-inf", "1e309", "-1e308", "1e-320", "0", "-0.0", "-1", "1", "3", "99999999999999999999", "0x10",
    "1_000", "1e", ".", "", "true", '"text"', "[]", "[1, 2]", "{}",
)  # fmt: skip
_FLOATS = (np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-45, 0.0, 1e9, -1.0)
_COUNTS = (0, 1, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**400, 0.5, -1e308, 1e-320, "", "text", "\0", "../" * 6 + "etc/passwd",
    "built-in", [], {}, [[]], [0.0] * 4, {"a": {}},
)  # fmt: skip
_TOO_FAR = (b"9" * 5000, b"[" * 5000, b'{"a":' * 3000, b"<a>" * 3000, b"x" * 5000, b"a\\u0000b", b"\0")
_ODD_WORDS = (
    "--", "-", "=", "--json=1", "--seed=-1", "--no-such", "-h", "*", "~", "é", "\udcff", "a b", "x" * 5000, "[" * 5000,
)  # fmt: skip
_TOKEN_EDGES = frozenset(b" \t\r\n,;:=[](){}<>\"'/")


def damage_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return `data` with one kind of damage that knows nothing of formats."""
    return bytes(_BYTE_DAMAGE[rng.integers(len(_BYTE_DAMAGE))](bytearray(data), rng))


def damage_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the text `data` with a word, a number or a line changed, doubled, moved or dropped."""
    return _TEXT_DAMAGE[rng.integers(len(_TEXT_DAMAGE))](data, rng)


def _span(size: int, rng: np.random.Generator) -> slice:
    first = int(rng.integers(size + 1))
    return slice(first, min(size, first + int(2 ** rng.uniform(0, 10))))


def _cut(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[: rng.integers(len(data) + 1)]


def _flip(data: bytearray, rng: np.random.Generator) -> bytearray:
    for _ in range(int(2 ** rng.uniform(0, 6))):
        if data:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return data


def _remove(data: bytearray, rng: np.random.Generator) -> bytearray:
    del data[_span(len(data), rng)]
    return data


def _double(data: bytearray, rng: np.random.Generator) -> bytearray:
    span = _span(len(data), rng)
    data[span] = data[span] * int(2 ** rng.uniform(1, 8))
    return data


def _noise(data: bytearray, rng: np.random.Generator) -> bytearray:
    span = _span(len(data), rng)
    data[span] = rng.bytes(span.stop - span.start + int(rng.integers(8)))
    return data


def _number(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Overwrite four bytes with a float or a count that a binary format might believe."""
    if len(data) < _WORD:
        return data
    at = int(rng.integers(len(data) - _WORD + 1))
    at -= at % _WORD * int(rng.integers(2))
    kind = rng.integers(2)
    with np.errstate(over="ignore"):
        word = struct.pack("<I", _COUNTS[rng.integers(len(_COUNTS))]) if kind else None
        data[at : at + _WORD] = word or struct.pack("<f", _FLOATS[rng.integers(len(_FLOATS))])
    return data


def _nothing(data: bytearray, rng: np.random.Generator) -> bytes:
    return (b"", b"\0" * len(data), b"\xff\xfe" + data, b"\n")[rng.integers(4)]


_BYTE_DAMAGE: tuple[Callable[[bytearray, np.random.Generator], bytes | bytearray], ...] = (
    _cut, _cut, _flip, _flip, _remove, _double, _noise, _number, _number, _number, _nothing,
)  # fmt: skip


def _tokens(data: bytes) -> list[tuple[int, int]]:
    """Return begin and end of the words of a text."""
    found, begin = [], None
    for i, byte in enumerate(data):
        edge = byte in _TOKEN_EDGES
        if begin is None and not edge:
            begin = i
        elif begin is not None and edge:
            found.append((begin, i))
            begin = None
    return found + ([(begin, len(data))] if begin is not None else [])


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _replace_word(data: bytes, rng: np.random.Generator, *, numbers: bool) -> bytes:
    tokens = [(a, b) for a, b in _tokens(data) if not numbers or _is_number(data[a:b])]
    if not tokens:
        return data
    begin, end = tokens[rng.integers(len(tokens))]
    other_begin, other_end = tokens[rng.integers(len(tokens))]
    new = data[other_begin:other_end] if not numbers else _NUMBERS[rng.integers(len(_NUMBERS))].encode()
    return data[:begin] + new + data[end:]


def _go_too_far(data: bytes, rng: np.random.Generator) -> bytes:
    """Put something longer or deeper than a parser may expect in the place of a word."""
    tokens = _tokens(data)
    if not tokens:
        return data
    begin, end = tokens[rng.integers(len(tokens))]
    return data[:begin] + _TOO_FAR[rng.integers(len(_TOO_FAR))] + data[end:]


def _change_number(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace_word(data, rng, numbers=True)


def _swap_word(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace_word(data, rng, numbers=False)


def _change_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    at, other = (int(rng.integers(len(lines))) for _ in range(2))
    kind = rng.integers(4)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    elif kind == 2:
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at] = lines[at] * int(2 ** rng.uniform(1, 10))
    return b"".join(lines)


_TEXT_DAMAGE: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _change_number, _change_number, _swap_word, _change_lines, _go_too_far,
)  # fmt: skip


def damage_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the JSON text `data` with up to three nodes replaced, dropped, doubled or swapped."""
    value = json.loads(data)
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(value))
        if not places:
            break
        parent, key = places[rng.integers(len(places))]
        other_parent, other_key = places[rng.integers(len(places))]
        kind = rng.integers(6)
        if kind < 3:
            parent[key] = copy.deepcopy(_VALUES[rng.integers(len(_VALUES))])
        elif kind == 3:
            parent[key] = copy.deepcopy(other_parent[other_key])
        elif kind == 4:
            del parent[key]
        elif isinstance(parent, list):
            parent.extend(copy.deepcopy(parent[key]) for _ in range(int(2 ** rng.uniform(0, 6))))
        else:
            parent[f"{key}x"] = parent.pop(key)
    return json.dumps(value).encode()


def _places(value: Any, depth: int = 0) -> list[tuple[Any, Any]]:
    """Return (container, key) of the nodes; containers come again so that long lists of numbers do not drown them."""
    keys = range(len(value)) if isinstance(value, list) else list(value) if isinstance(value, dict) else ()
    found = []
    for key in list(keys)[: 400 if depth else None]:
        found += [(value, key)] * (4 if isinstance(value[key], (dict, list)) else 1)
        found += _places(value[key], depth + 1)
    return found


def damage_xml(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the XML text `data` with elements dropped, doubled, nested, renamed, or with other attributes."""
    root = ET.fromstring(data)
    for _ in range(int(rng.integers(1, 4))):
        elements = [*root.iter()]
        parent, other = (elements[rng.integers(len(elements))] for _ in range(2))
        kind = rng.integers(5)
        if kind == 0 and len(parent):
            parent.remove(parent[int(rng.integers(len(parent)))])
        elif kind == 1 and sum(1 for _ in other.iter()) < 60:
            parent.append(copy.deepcopy(other))
        elif kind == 2:
            parent.tag = other.tag
        elif parent.attrib:
            names = [*parent.attrib]
            name = names[rng.integers(len(names))]
            if kind == 3:
                words = parent.attrib[name].split(" ")
                words[int(rng.integers(len(words)))] = _NUMBERS[rng.integers(len(_NUMBERS))]
                parent.attrib[name] = " ".join(words)
            else:
                del parent.attrib[name]
    return ET.tostring(root)


def damage_safetensors(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the safetensors file `data` with its header damaged as JSON, the header's length made to fit again."""
    (size,) = struct.unpack("<Q", data[:8])
    header, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    if rng.integers(2) and "regrasp_opt" in header.get("__metadata__", {}):
        inner = header["__metadata__"]["regrasp_opt"].encode()
        header["__metadata__"]["regrasp_opt"] = damage_json(inner, rng).decode()
        text = json.dumps(header).encode()
    else:
        text = damage_json(json.dumps(header).encode(), rng)
    return struct.pack("<Q", len(text)) + text + body


def damage_arrays(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the archive of arrays `data` with one of them missing, cut, of another type, or with strange numbers."""
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        arrays = dict(stored)
    name = [*arrays][rng.integers(len(arrays))]
    array = arrays.pop(name)
    kind = rng.integers(6)
    if kind == 0 and array.dtype.kind == "f" and array.size:
        array = array.copy()
        array.flat[rng.integers(array.size)] = _FLOATS[rng.integers(len(_FLOATS))]
    elif kind == 1:
        array = array.ravel()[: rng.integers(array.size + 1)]
    elif kind == 2:
        array = array[..., None] if rng.integers(2) else array.ravel()[:0]
    elif kind == 3:
        array = array.astype(("U", np.float32, np.int8, np.complex128)[rng.integers(4)])
    elif kind == 4:
        name = f"{name}x"
    if kind != 5:
        arrays[name] = array
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def damage_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the command line `data`, a JSON list of words, with a value changed, or a word dropped or moved."""
    words = [str(word) for word in json.loads(data)]
    values = [i for i, word in enumerate(words) if i and not word.startswith("-")]
    if not values:
        return data
    at, other = values[rng.integers(len(values))], int(rng.integers(len(words)))
    kind = rng.integers(9)
    if kind < 5:
        choice = _ODD_WORDS if kind == 0 else _NUMBERS
        words[at] = choice[rng.integers(len(choice))]
    elif kind == 5:
        words[at] = words[at][: rng.integers(len(words[at]) + 1)]
    elif kind == 6:
        words[at], words[other] = words[other], words[at]
    elif kind == 7:
        words.insert(at, words[other])
    else:
        del words[other]
    return json.dumps(words).encode()
