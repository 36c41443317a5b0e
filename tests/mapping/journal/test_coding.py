"""Chunks as bytes and back."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.mapping.journal.coding import MOST_BYTES, decode, encode
from companion.mapping.voxels.chunks import NOTHING, VOLUME
from tests.mapping.journal.journals import alike, surface

EXTREMES = [int(NOTHING), -32767, -1, 0, 1, 255, 256, 32767]


@st.composite
def a_chunk(draw: st.DrawFn) -> NDArray[np.int16]:
    """Bricks of every kind: alike, alike as the last one, few values, as many as fit into a list, and all different."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    counts = draw(st.lists(st.sampled_from([1, 1, 2, 3, 16, 17, 32, 33, 38, 39, 40, 64]), min_size=64, max_size=64))
    bricks = np.empty((64, 64), np.int16)
    for brick, count in enumerate(counts):
        values = np.append(random.integers(-32768, 32768, 56), EXTREMES).astype(np.int16)
        bricks[brick] = random.permutation(np.resize(random.permutation(values)[:count], 64))
        if count == 1 and brick and random.random() < 0.5:
            bricks[brick] = bricks[brick - 1, 0]
    return bricks.reshape(VOLUME)


def coded(values: NDArray[np.int16], gap: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Bytes of some chunks, and their sizes."""
    out = np.full(len(values) * (gap + MOST_BYTES), 77, np.uint8)
    sizes = encode(values, out, gap)
    return out, sizes


@given(st.lists(a_chunk(), max_size=3), st.sampled_from([0, 24]))
def test_what_is_encoded_comes_back(chunks: list[NDArray[np.int16]], gap: int) -> None:
    """Protects every voxel on the disk: whatever a chunk holds, it comes back as it was, and as small as promised."""
    values = np.array(chunks, np.int16).reshape(-1, VOLUME)
    out, sizes = coded(values, gap)
    ends = np.cumsum(sizes + gap)
    for chunk, size, end in zip(values, sizes, ends, strict=True):
        assert np.all(out[end - size - gap : end - size] == 77)
        bricks = chunk.reshape(64, 64)
        mixed = np.count_nonzero(np.any(bricks != bricks[:, :1], axis=1))
        assert size <= 129 * mixed + 3 * (64 - mixed)
        back = np.empty((1, VOLUME), np.int16)
        assert decode(out[end - size : end], np.array([0, size]), back).tolist() == [True]
        assert np.array_equal(back[0], chunk)


@given(st.binary(max_size=400))
def test_any_bytes_are_decoded_or_refused(data: bytes) -> None:
    """Protects from bytes that no encoder wrote: compiled code must neither read nor write beyond what it was given."""
    room = np.full((3, VOLUME), 1234, np.int16)
    valid = decode(np.frombuffer(data, np.uint8), np.array([0, len(data)]), room[1:2])
    assert np.all(room[[0, 2]] == 1234)
    if valid[0]:
        out, sizes = coded(room[1:2])
        back = np.empty((1, VOLUME), np.int16)
        assert decode(out[: sizes[0]], np.array([0, sizes[0]]), back)[0]
        assert np.array_equal(back, room[1:2])


@given(st.integers(0, 10_000), st.data())
def test_a_shorter_or_longer_chunk_is_refused(seed: int, data: st.DataObject) -> None:
    """Protects from half a chunk: the bytes of a chunk without their end, or with more behind, are none."""
    out, sizes = coded(surface(seed)[np.newaxis])
    size = int(sizes[0])
    cut = data.draw(st.integers(0, size - 1))
    back = np.empty((1, VOLUME), np.int16)
    assert not decode(out[:cut], np.array([0, cut]), back)[0]
    assert not decode(out[: size + 1], np.array([0, size + 1]), back)[0]


def test_what_never_changes_costs_next_to_nothing() -> None:
    """Protects the disk of a vehicle that flies through wide halls: free and unknown chunks take a byte a brick."""
    _, sizes = coded(np.array([alike(-1992), alike(int(NOTHING))]))
    assert sizes.tolist() == [66, 64]
