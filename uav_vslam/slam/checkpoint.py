# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of the back end, from which a process that died goes on.

A checkpoint is the whole state of `SlamStage`: estimate, information, map, tracks and the frames that wait. It belongs
to one session: what the restored back end publishes comes from the same measurements, so its session stays the same,
and peers replace what they have instead of counting it twice. Only identifiers of landmarks must not be used again.
Landmarks archived for a saved map are left out; the map of a restarted back end starts empty.

The file is a pickle, of this program for this program: it is read from the user's own state folder only.
"""

import pickle
from pathlib import Path

from uav_vslam import __version__
from uav_vslam.errors import ConfigError
from uav_vslam.slam.stage import SlamStage
from uav_vslam.slam.state_folder import replace_file

Written = tuple[str, str, SlamStage]


def checkpoint_file(folder: Path, vehicle: str) -> Path:
    """Return where a vehicle's checkpoint is kept."""
    return folder / f"{vehicle}.checkpoint"


def save_checkpoint(path: Path, stage: SlamStage, vehicle: str) -> None:
    """Write a checkpoint in place of the one before, atomically for other processes.

    Raises:
        OSError: the disk is full, or the folder can't be written.
    """
    written: Written = (__version__, vehicle, stage)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, pickle.dumps(written, protocol=pickle.HIGHEST_PROTOCOL), durable=False)


def load_checkpoint(path: Path, vehicle: str) -> SlamStage:
    """Return the stage of a checkpoint, ready to go on.

    Raises:
        ConfigError: there is none, it is damaged, or of another version or vehicle.
    """
    try:
        version, owner, stage = pickle.loads(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: no checkpoint to resume from ({error.strerror})") from None
    except Exception as error:  # whatever a damaged pickle does
        raise ConfigError(f"{path}: the checkpoint is damaged ({type(error).__name__}: {error})") from None
    if (version, owner) != (__version__, vehicle):
        raise ConfigError(f"{path}: the checkpoint is of {owner}, version {version}, not of {vehicle}, {__version__}")
    stage.resume()
    return stage
