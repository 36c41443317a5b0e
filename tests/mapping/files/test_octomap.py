"""OctoMap's files against OctoMap itself: ours read by it, its read by us."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import octomap
import pytest

from companion.mapping.files import MapFileError, open_map, write
from companion.mapping.files.octree_walk import BINARY_FREE, BINARY_OCCUPIED
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN, states_of
from tests.mapping.files.sources import EMPTY, Held, centres_m, contents, of_voxels, room, scattered

LABELS = {UNKNOWN: -1, FREE: 0, OCCUPIED: 1}
CORNERS = {(0, 0, 0): 900, (-1, -1, -1): 901, (32767, -32768, 5): 902, (-32768, 32767, 32767): -903}


def _binary(path: Path) -> octomap.OcTree:
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(path).encode())
    return tree


def _full(path: Path) -> octomap.OcTree:
    return octomap.OcTree.read(str(path).encode())


@pytest.mark.parametrize("source", [scattered(), room()], ids=["scattered", "room"])
def test_octomap_reads_every_state(source: Held, tmp_path: Path) -> None:
    """Protects the tree that planners use: OctoMap says of each voxel what the map says, also where it is unknown."""
    write(source, tmp_path / "map.bt")
    tree = _binary(tmp_path / "map.bt")
    assert tree.getResolution() == source.voxel_m
    assert tree.size() == tree.calcNumNodes()
    states = states_of(source.values, source.threshold)
    expected = np.select([states == state for state in LABELS], list(LABELS.values()))
    assert (np.asarray(tree.getLabels(centres_m(source).reshape(-1, 3))) == expected.ravel()).all()


@pytest.mark.parametrize("source", [scattered(1), room()], ids=["scattered", "room"])
def test_octomap_reads_every_log_odds(source: Held, tmp_path: Path) -> None:
    """Protects all that the map knows: OctoMap finds the log-odds of every voxel, and nothing where nothing is."""
    write(source, tmp_path / "map.ot")
    tree = _full(tmp_path / "map.ot")
    assert tree.size() == tree.calcNumNodes()
    known = source.values != NOTHING
    assert known.any()
    centres = centres_m(source)
    for row, place in np.random.default_rng(0).permutation(np.argwhere(known))[:5000]:
        log_odds = tree.search(centres[row, place]).getLogOdds()
        assert log_odds == pytest.approx(source.values[row, place] / 1000.0, abs=1e-6)
    labels = np.asarray(tree.getLabels(centres.reshape(-1, 3)))
    assert ((labels == -1) == ~known.ravel()).all()


@pytest.mark.parametrize("source", [scattered(2), room(), EMPTY, of_voxels(CORNERS)], ids=["s", "room", "empty", "far"])
def test_octomap_would_write_the_same_tree(source: Held, tmp_path: Path) -> None:
    """Protects the tree above the voxels: OctoMap prunes and computes inner nodes anew, and writes the same bytes."""
    write(source, tmp_path / "map.bt")
    write(source, tmp_path / "map.ot")
    tree = _binary(tmp_path / "map.bt")
    assert tree.writeBinary(str(tmp_path / "theirs.bt").encode())
    assert _tree_of(tmp_path / "theirs.bt") == _tree_of(tmp_path / "map.bt")
    tree = _full(tmp_path / "map.ot")
    tree.updateInnerOccupancy()
    assert tree.write(str(tmp_path / "theirs.ot").encode())
    assert _tree_of(tmp_path / "theirs.ot") == _tree_of(tmp_path / "map.ot")


def test_octomap_builds_the_same_tree(tmp_path: Path) -> None:
    """Protects pruning in `.ot`: OctoMap, given each voxel, prunes as it goes and writes the same bytes."""
    source = scattered(4, chunks=6)
    tree = octomap.OcTree(source.voxel_m)
    for point, value in zip(centres_m(source).reshape(-1, 3), source.values.ravel(), strict=True):
        if value != NOTHING:
            tree.updateNode(point, value / 1000.0)
    assert tree.write(str(tmp_path / "theirs.ot").encode())
    write(source, tmp_path / "map.ot")
    assert _tree_of(tmp_path / "theirs.ot") == _tree_of(tmp_path / "map.ot")
    assert tree.size() < 1.2 * np.count_nonzero(source.values != NOTHING)


def _tree_of(path: Path) -> tuple[bytes, bytes]:
    """The number of nodes and the tree, without comments."""
    head, _, tree = path.read_bytes().partition(b"data\n")
    return next(line for line in head.splitlines() if line.startswith(b"size")), tree


@pytest.mark.parametrize("source", [scattered(3), room(), EMPTY, of_voxels(CORNERS)], ids=["s", "room", "empty", "far"])
def test_what_is_written_is_read(source: Held, tmp_path: Path) -> None:
    """Protects a map that is kept as a file: `.ot` gives all of it back, `.bt` what is free and what is occupied."""
    write(source, tmp_path / "map.ot")
    write(source, tmp_path / "map.bt")
    full, binary = open_map(tmp_path / "map.ot"), open_map(tmp_path / "map.bt")
    assert (full.voxel_m, full.threshold) == (source.voxel_m, source.threshold)
    assert contents(full) == contents(source)
    states = states_of(source.values, source.threshold)
    expected = np.select([states == FREE, states == OCCUPIED], [BINARY_FREE, BINARY_OCCUPIED], NOTHING)
    assert contents(binary) == contents(Held(source.chunks, expected))


def _their_tree(kind: type = octomap.OcTree) -> octomap.OcTree:
    """A tree that OctoMap built: a fan of rays, and a large cube that it pruned to one leaf above our chunks."""
    tree = kind(0.1)
    angles = np.linspace(0, 2 * np.pi, 400)
    points = np.stack([5 * np.cos(angles), 4 * np.sin(angles), np.sin(3 * angles)], axis=1)
    for _ in range(3):
        tree.insertPointCloud(points, np.zeros(3))
    side = (np.arange(32) + 0.5) * 0.1 + 6.4
    cube = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    for point in cube:
        tree.updateNode(point, -0.4, True)
    tree.updateInnerOccupancy()
    return tree


def test_what_octomap_built_is_read(tmp_path: Path) -> None:
    """Protects maps from other programs: each voxel's log-odds, and leaves that stand for many chunks."""
    tree = _their_tree()
    assert tree.write(str(tmp_path / "theirs.ot").encode())
    opened = open_map(tmp_path / "theirs.ot")
    assert (opened.voxel_m, opened.threshold) == (0.1, 0)
    known = 0
    for piece in opened.pieces(7):
        assert len(piece.chunks) <= 7
        held = Held(piece.chunks, piece.values)
        labels = np.asarray(tree.getLabels(centres_m(held).reshape(-1, 3))).reshape(-1, 4096)
        assert ((piece.values == NOTHING) == (labels == -1)).all()
        assert ((piece.values >= 0) == (labels == 1)).all()
        centres = centres_m(held)
        for row, place in np.argwhere(piece.values != NOTHING)[::50]:
            node = tree.search(centres[row, place])
            assert node.getLogOdds() == pytest.approx(piece.values[row, place] / 1000.0, abs=0.00051)
        known += int(np.count_nonzero(piece.values != NOTHING))
    # The cube alone is 32 voxels along each side.
    assert known > 32**3


@pytest.mark.parametrize("suffix", ["ot", "bt"])
def test_a_tree_with_colours_is_read_for_its_occupancy(tmp_path: Path, suffix: str) -> None:
    """Protects maps of cameras with colours: three bytes more in each node, and the same log-odds in every voxel."""
    for kind in (octomap.OcTree, octomap.ColorOcTree):
        tree = _their_tree(kind)
        if kind is octomap.ColorOcTree:
            for place_m in ([5.0, 0.0, 0.0], [6.55, 6.55, 6.55]):
                assert tree.setNodeColor(np.array(place_m), 200, 10, 30)
        path = str(tmp_path / f"{kind.__name__}.{suffix}").encode()
        assert tree.write(path) if suffix == "ot" else tree.writeBinary(path)
    with_colours, without = (open_map(tmp_path / f"{name}.{suffix}") for name in ("ColorOcTree", "OcTree"))
    assert contents(with_colours) == contents(without)
    assert len(contents(without)) > 8


def test_what_octomap_built_is_read_as_binary(tmp_path: Path) -> None:
    """Protects the format that most other programs write."""
    tree = _their_tree()
    assert tree.writeBinary(str(tmp_path / "theirs.bt").encode())
    labels = {}
    for chunk, values in contents(open_map(tmp_path / "theirs.bt")).items():
        held = Held(np.array([chunk], np.int32), np.frombuffer(values, np.int16).reshape(1, 4096))
        labels[chunk] = np.asarray(tree.getLabels(centres_m(held).reshape(-1, 3)))
        expected = np.select([held.values == NOTHING, held.values < 0], [-1, 0], 1)
        assert (expected[0] == labels[chunk]).all()
    assert sum(np.count_nonzero(some != -1) for some in labels.values()) > 32**3


def test_a_single_leaf_is_one_chunk(tmp_path: Path) -> None:
    """Protects pruning: 4096 equal voxels are a single leaf, twelve levels down."""
    source = Held(np.array([[0, 0, 0]], np.int32), np.full((1, 4096), -700, np.int16))
    for suffix, read in ((".bt", _binary), (".ot", _full)):
        path = tmp_path / f"map{suffix}"
        write(source, path)
        tree = read(path)
        assert (tree.getNumLeafNodes(), tree.size()) == (1, 13)
        assert list(tree.getLabels(np.array([[1.59, 0.01, 0.8], [1.61, 0.01, 0.8]]))) == [0, -1]


@pytest.mark.parametrize("voxel", [(32768, 0, 0), (0, -32769, 0)], ids=str)
@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_octomap_cannot_hold_what_is_too_far(voxel: tuple[int, int, int], suffix: str, tmp_path: Path) -> None:
    """Protects from coordinates that wrap around: an error says how far the format reaches, and nothing is written."""
    with pytest.raises(MapFileError, match=r"further than 3276.8 m .* use larger voxels"):
        write(of_voxels({voxel: -500}), tmp_path / f"map{suffix}")
    assert list(tmp_path.iterdir()) == []
