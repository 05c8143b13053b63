# SPDX-License-Identifier: Apache-2.0
"""The training script for compact descriptors makes a usable basis."""

import runpy
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

SCRIPT = Path(__file__).parents[1] / "scripts" / "train_descriptors.py"


def test_a_basis_is_trained_from_a_folder_of_images(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "ground").mkdir()
    for k in range(2):
        image = cv2.GaussianBlur(rng.integers(0, 256, (480, 640), np.uint8), (0, 0), 3.0)
        cv2.imwrite(str(tmp_path / "ground" / f"{k}.png"), cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX))
    (tmp_path / "ground" / "notes.txt").write_text("not an image")
    out = tmp_path / "descriptor_basis_2.npz"
    command = [sys.executable, SCRIPT, out, "--images", tmp_path / "ground", "--provenance", "noise, CC0"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    basis = np.load(out)
    assert basis["components"].shape == (32, 128)
    assert basis["mean"].shape == (128,)
    assert str(basis["provenance"]) == "noise, CC0"
    assert basis["levels_per_unit"] > 100
    assert 0 < basis["single_distance"] < 250


def test_training_finds_the_principal_directions_and_codes_use_their_range() -> None:
    script = runpy.run_path(str(SCRIPT))
    rng = np.random.default_rng(2)
    descriptors = np.full((400, 128), 40, np.uint8)
    descriptors[:, :4] = rng.integers(0, 256, (400, 4))
    basis = script["train_basis"](descriptors, components=4, provenance="made up")
    assert np.abs(basis.components[:, 4:]).max() < 0.2
    codes = basis.compress(descriptors)
    assert codes[:, 0].min() <= 10
    assert codes[:, 0].max() >= 245
    assert basis.bytes == 4
