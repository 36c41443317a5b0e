"""The way flown, from the files beside a map."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.errors import InputError
from companion.viewer.voxels import trajectories


def test_every_file_is_a_way(tmp_path: Path) -> None:
    """Protects missions with several vehicles; rows without a position are left out, not drawn at the origin."""
    (tmp_path / "trajectory-1.csv").write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n1,,2,3\n2,nan,2,3\n3,4,5,6\n")
    (tmp_path / "trajectory-2.csv").write_text("t_s,x_m,y_m,z_m\n")
    found = trajectories(tmp_path)
    assert found["trajectory-1.csv"].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found["trajectory-2.csv"].shape == (0, 3)


def test_the_map_is_in_the_frame_of_the_estimate(tmp_path: Path) -> None:
    """Protects simulated missions with drift: the true way would not lie in the map that the vehicle made."""
    columns = "x_m,y_m,z_m,estimated_x_m,estimated_y_m,estimated_z_m"
    (tmp_path / "trajectory.csv").write_text(f"{columns}\n0,0,0,1,2,3\n")
    assert trajectories(tmp_path)["trajectory.csv"].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("text", ["time,lat,lon\n0,1,2\n", "x_m,y_m,z_m\n1,two,3\n", ""])
def test_a_file_of_something_else_is_named(tmp_path: Path, text: str) -> None:
    """Protects from a traceback: one message with the file, and what to do."""
    (tmp_path / "trajectory.csv").write_text(text)
    with pytest.raises(InputError, match=r"trajectory\.csv: .* move it away to see the map without it"):
        trajectories(tmp_path)
