"""Damage to files: the same for the same seed, of every kind, and none where there is nothing to damage."""

import io
import json
import struct

import numpy as np
import pytest

from fuzz import mutations as damage

JSON = json.dumps({"a": [1, 2.5, {"b": None}], "c": "text", "d": {"e": [0.0] * 3}}).encode()
XML = b'<robot name="r"><link name="a"><origin xyz="0 0 1"/></link><joint name="j" type="fixed"/></robot>'
LINE = json.dumps(["plan", "--seed", "3", "--object", "mug"]).encode()


def safetensors(header):
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + b"\0" * 8


def arrays():
    file = io.BytesIO()
    np.savez(file, a=np.arange(6.0).reshape(2, 3), b=np.arange(3))
    return file.getvalue()


GOOD = {
    "bytes": b"some bytes, 1 2 3\n",
    "text": b"size = 1.5\nname = part\n",
    "json": JSON,
    "xml": XML,
    "safetensors": safetensors({"__metadata__": {"regrasp_opt": '{"format": 1}'}, "w": {"shape": [2]}}),
    "arrays": arrays(),
    "words": LINE,
}


def damaged(kind, data, seed):
    return getattr(damage, f"damage_{kind}")(data, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", GOOD)
def test_the_same_seed_does_the_same_damage_and_others_do_other(kind):
    found = [damaged(kind, GOOD[kind], seed) for seed in range(60)]
    assert found == [damaged(kind, GOOD[kind], seed) for seed in range(60)]
    assert len(set(found)) > 15 and sum(one != GOOD[kind] for one in found) > 30


@pytest.mark.parametrize(
    ("kind", "nothing"), [("text", b""), ("json", b"[]"), ("json", b"7"), ("words", b'["plan"]'), ("words", b"[]")]
)
def test_a_file_in_which_there_is_nothing_to_damage_stays(kind, nothing):
    assert {damaged(kind, nothing, seed) for seed in range(40)} == {nothing}


def test_a_line_without_words_is_dropped_or_repeated():
    line = b" ,;\n"
    found = {damaged("text", line, seed) for seed in range(100)}
    assert {b"", line} < found and all(one == line * (len(one) // len(line)) for one in found)


@pytest.mark.parametrize("data", [b"", b"ab"])
def test_short_and_empty_bytes_are_damaged_too(data):
    found = {damaged("bytes", data, seed) for seed in range(60)}
    assert len(found) > 5 and b"" in found and max(map(len, found)) > len(data)


@pytest.mark.parametrize("kind", ["json", "words"])
def test_damaged_json_is_json(kind):
    for seed in range(60):
        json.loads(damaged(kind, GOOD[kind], seed))


def test_the_length_of_a_damaged_header_is_right():
    for header in ({"w": {"shape": [2]}}, {"__metadata__": {"regrasp_opt": '{"format": 1}'}}):
        for seed in range(40):
            data = damaged("safetensors", safetensors(header), seed)
            (size,) = struct.unpack("<Q", data[:8])
            json.loads(data[8 : 8 + size])
            assert data[8 + size :] == b"\0" * 8


def test_damaged_arrays_are_an_archive_with_something_else_in_it():
    before = dict(np.load(io.BytesIO(arrays())))
    seen = set()
    for seed in range(60):
        after = dict(np.load(io.BytesIO(damaged("arrays", arrays(), seed))))
        seen.add((len(after), "".join(sorted(after)), *sorted(str(a.dtype) for a in after.values())))
        assert set(after) <= {"a", "b", "ax", "bx"} and len(after) <= len(before)
    assert len(seen) > 5
