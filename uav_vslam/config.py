# SPDX-License-Identifier: Apache-2.0
"""Every parameter of a vehicle and of a fleet: the one home of defaults, units and valid ranges.

YAML files under `config/` hold differences only; ROS parameters are generated from these fields (`backend.sigma_px`).
An unknown key, a wrong type or a value out of range raises `ConfigError` that names the file, the key and the remedy.
"""

import dataclasses
import difflib
import math
import os
import types
import typing
from collections.abc import Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.errors import ConfigError


def _require(condition: bool, owner: object, key: str, allowed: str) -> None:
    if not condition:
        raise ConfigError(f"{type(owner).__name__}.{key} = {getattr(owner, key)!r} is not allowed; use {allowed}")


@dataclass(frozen=True, slots=True)
class ImuConfig:
    """Noise of the inertial unit (continuous-time densities) and how it is known at the start; defaults ADIS16480."""

    gyro_noise: float = 1.2e-4  # white noise [rad/s/sqrt(Hz)]
    accel_noise: float = 1.1e-3  # white noise [m/s^2/sqrt(Hz)]
    gyro_bias_walk: float = 1.0e-6  # bias random walk [rad/s^2/sqrt(Hz)]
    accel_bias_walk: float = 1.0e-5  # bias random walk [m/s^3/sqrt(Hz)]
    gyro_bias_sigma: float = 5.0e-4  # turn-on bias left after warm-up [rad/s]
    accel_bias_sigma: float = 5.0e-2  # turn-on bias left after warm-up [m/s^2]
    gravity: float = 9.80665  # local gravity, along -z of the map frame [m/s^2]

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            _require(getattr(self, f.name) > 0, self, f.name, "a positive number")


THESIS_STEP_S = 0.14  # its control noise is drawn once a step; ours is white at the reading's rate, of the same effect
THESIS_NOISE = ((1.0, 1.8), (2.0, 3.6), (2.0, 5.6), (4.0, 11.2))  # w1 to w4 of section 4.7.1 [deg/s], [m/s^2]


def _thesis_noise(rate_deg: float, accel: float) -> ImuConfig:
    return ImuConfig(
        gyro_noise=math.radians(rate_deg) * math.sqrt(THESIS_STEP_S), accel_noise=accel * math.sqrt(THESIS_STEP_S)
    )


IMU_GRADES = {
    "adis16480": ImuConfig(),
    "consumer": ImuConfig(
        gyro_noise=5.0e-4,
        accel_noise=4.0e-3,
        gyro_bias_walk=1.0e-5,
        accel_bias_walk=1.0e-4,
        gyro_bias_sigma=3.0e-3,
        accel_bias_sigma=2.0e-1,
    ),
    "thesis_half": _thesis_noise(0.5, 0.9),  # sigma_w = 0.5 of section 7.3.2, taken as half of w1
} | {f"thesis_w{k}": _thesis_noise(rate_deg, accel) for k, (rate_deg, accel) in enumerate(THESIS_NOISE, start=1)}


# The names in vision.features.EXTRACTORS.
EXTRACTORS = ("sift", "asift", "surf", "dsift", "phow_rgb", "phow_hsv", "phow_opponent", "orb")
FRONTEND_METHODS = ("klt", "sift")  # the names in vision.frontends.FRONTENDS


@dataclass(frozen=True, slots=True)
class FrontendConfig:
    """Stereo features."""

    method: str = "klt"  # points found now and then are followed; sift: each pair is searched and matched anew
    extractor: str = "sift"  # name in vision.features.EXTRACTORS; dsift and phow_* lie on a grid, too coarse for a map
    search_every: int = 3  # klt: frames from one search for new points to the next
    search_scale: float = 0.25  # klt: images are shrunk by this factor for the search (INTER_AREA)
    max_tracks: int = 300  # klt: points that are followed
    scale: float = 0.5  # sift: images are shrunk by this factor before detection (INTER_AREA)
    max_features: int = 1000  # keypoints kept per image, strongest first
    contrast_threshold: float = 0.01  # SIFT contrast threshold (OpenCV's own default 0.04 starves on grass)
    ratio: float = 0.8  # sift: nearest / second-nearest descriptor distance, left to right
    epipolar_px: float = 2.0  # largest distance to the epipolar line, full-resolution pixels; wider if rig.flexing
    min_depth_m: float = 0.3  # nearer points are rejected
    max_depth_m: float = 500.0  # farther points are rejected
    max_matches: int = 400  # sift: stereo points handed on, spread over the image

    def __post_init__(self) -> None:
        _require(self.extractor in EXTRACTORS, self, "extractor", f"one of {', '.join(EXTRACTORS)}")
        _require(self.method in FRONTEND_METHODS, self, "method", f"one of {', '.join(FRONTEND_METHODS)}")
        _require(self.search_every > 0, self, "search_every", "a positive count")
        _require(0.1 <= self.search_scale <= 1.0, self, "search_scale", "0.1 to 1")
        _require(self.max_tracks > 0, self, "max_tracks", "a positive count")
        _require(0.1 <= self.scale <= 1.0, self, "scale", "0.1 to 1")
        _require(self.max_features > 0, self, "max_features", "a positive count")
        _require(self.contrast_threshold >= 0, self, "contrast_threshold", "zero or more")
        _require(0.0 < self.ratio <= 1.0, self, "ratio", "a number in (0, 1]")
        _require(self.epipolar_px > 0, self, "epipolar_px", "a positive distance in pixels")
        _require(0 < self.min_depth_m < self.max_depth_m, self, "min_depth_m", "a depth between 0 and max_depth_m")
        _require(self.max_matches > 0, self, "max_matches", "a positive count")


FILTERS = ("eif", "ekf", "ukf", "uhf", "thesis_ukf", "thesis_uhf")  # the names in estimation.filters.FILTERS
STATE_MODELS = ("ri15", "so15", "euler9")  # the names in estimation.models.MODELS
# The names in slam.map_manager.RETENTION.
RETENTION_POLICIES = ("grid", "most_observed", "none", "first_last", "largest_covariance")


ASSOCIATIONS = (  # the names in association.ASSOCIATORS
    "gated",
    "gated_classification",
    "classification",
    "nn",
    "ransac",
    "gtm",
    "hgtm",
    "gated_ransac",
    "gated_gtm",
    "gated_hgtm",
    "cds",
    "coarse_fine",
)


@dataclass(frozen=True, slots=True)
class BackendConfig:
    """The own-only filter and its map."""

    filter: str = "eif"  # name in estimation.filters.FILTERS
    model: str = "ri15"  # name in estimation.models.MODELS: ri15 or the thesis's euler9
    gamma: float = 100.0  # of the unscented H-infinity filter: smaller is more cautious; never below what is feasible
    sigma_px: float = 1.0  # standard deviation of each stereo pixel coordinate [px]
    depth_sigma_ratio: float = 0.043  # relief / height, smooths the depth in the Jacobian; 0 turns it off (indoors)
    association: str = "gated"  # name in association.ASSOCIATORS: gated looks near where landmarks are expected
    min_descriptor_ratio: float = 0.85  # nearest / second-nearest inside the gate
    gate_probability: float = 0.99  # of the chi-square gate on a predicted observation
    robust: bool = True  # observations that fit badly after the update are weighed down (Huber), the update repeated
    pnp_px: float = 4.0  # reprojection error of a PnP inlier [px]
    min_pnp_inliers: int = 6  # fewer, and the frame is tried un-gated against the whole map
    min_relocalisation_inliers: int = 12  # fewer, and the vehicle coasts on its INS
    redetection_px: float = 0.0  # by how much a place that is found again after long lies beside where it was first
    min_revisited: int = 2  # landmarks long unseen, whose gates drift made wide, are believed if so many agree
    pnp_beyond_px: float = 8.0  # PnP checks the matches when the median predicted 1-sigma is wider than this [px]
    iterate_beyond_m: float = 0.05  # PnP and INS differ by more: the update is linearised at the PnP pose
    max_observations: int = 100  # updates a frame, spread over the image
    max_new_landmarks: int = 40  # landmarks added a frame
    max_in_view: int = 120  # with so many landmarks in view no new ones are added
    max_landmarks: int = 200  # in the state, retained ones included, which are as many as those in view leave room for
    retention: str = "grid"  # how landmarks out of view are kept: a name in slam.map_manager.RETENTION
    retention_cell_m: float = 25.0  # one retained landmark per cell of this size
    young_frames: int = 5  # younger landmarks are not removed for space

    def __post_init__(self) -> None:
        _require(self.filter in FILTERS, self, "filter", f"one of {', '.join(FILTERS)}")
        _require(self.gamma > 0, self, "gamma", "a positive number")
        _require(self.model in STATE_MODELS, self, "model", f"one of {', '.join(STATE_MODELS)}")
        _require(self.association in ASSOCIATIONS, self, "association", f"one of {', '.join(ASSOCIATIONS)}")
        _require(self.retention in RETENTION_POLICIES, self, "retention", f"one of {', '.join(RETENTION_POLICIES)}")
        _require(self.sigma_px > 0, self, "sigma_px", "a positive number of pixels")
        _require(self.depth_sigma_ratio >= 0, self, "depth_sigma_ratio", "zero (off) or more")
        _require(self.redetection_px >= 0, self, "redetection_px", "zero or more pixels")
        _require(0 < self.min_descriptor_ratio <= 1, self, "min_descriptor_ratio", "a number in (0, 1]")
        _require(0 < self.gate_probability < 1, self, "gate_probability", "a probability in (0, 1)")
        for key in ("pnp_px", "iterate_beyond_m"):
            _require(getattr(self, key) > 0, self, key, "a positive number")
        _require(self.pnp_beyond_px >= 0, self, "pnp_beyond_px", "zero (always) or more")
        for key in ("max_observations", "max_in_view", "young_frames"):
            _require(getattr(self, key) > 0, self, key, "a positive count")
        _require(self.max_new_landmarks >= 0, self, "max_new_landmarks", "zero or more")
        _require(self.min_revisited > 0, self, "min_revisited", "a positive count")
        for key in ("min_pnp_inliers", "min_relocalisation_inliers"):
            _require(getattr(self, key) >= 4, self, key, "4 or more, as a pose takes three points and one to check it")
        _require(self.max_landmarks >= self.max_in_view, self, "max_landmarks", "at least max_in_view")
        _require(self.retention_cell_m > 0, self, "retention_cell_m", "a positive length [m]")


@dataclass(frozen=True, slots=True)
class RigConfig:
    """How far the calibration may be trusted: the attitude of the right camera, and the cameras' clock."""

    flexing: bool = False  # the cameras' mutual attitude drifts and vibrates, so it is estimated
    attitude_sigma_deg: float = 0.05  # flexing: slow part at the start, per axis; best twice what is expected
    attitude_walk_deg: float = 0.001  # flexing: random walk of the slow part [deg/sqrt(s)]
    vibration_sigma_deg: float = 0.05  # flexing: part that is new in each frame, rms per axis
    rigid_sigma_deg: float = 5.0e-4  # not flexing: what calibration left, small, but a doubt that data can speak to
    time_offset_sigma_s: float = 0.0  # camera clock against IMU clock, estimated; 0 believes them equal

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            if f.name != "flexing":
                _require(getattr(self, f.name) >= 0, self, f.name, "zero or more")


FUSION_SCHEMES = ("split_ci", "full_ci", "overlay", "inverse_ci")
FUSION_WEIGHTS = ("position_trace", "trace", "determinant", "niehsen", "franken_hupper")


# Communication modes, and what a vehicle may send in each: payload, before DDS, UDP and IP [B/s].
MODE_BUDGETS = {"wideband": 100_000, "narrowband": 900, "none": 0}
MAX_PACKET_LANDMARKS = 400  # a packet that claims more is not believed: checking it costs the cube


@dataclass(frozen=True, slots=True)
class FusionConfig:
    """Cooperation with peers."""

    mode: str = "wideband"  # wideband, narrowband or none
    budget_bytes_per_s: int = 0  # payload that is sent at most; 0: as much as the mode allows
    silent_after_s: float = 5.0  # a peer whose last packet was made longer ago is reported as silent
    epoch_s: float = 1.0  # whenever a stamp passes a multiple: a fusion, and a packet (narrowband: two of three)
    min_delay_s: float = 0.2  # only packets at least this much older than the epoch enter: makes replay repeatable
    scheme: str = "split_ci"  # how packets are brought in, in cooperation.schemes: split_ci, full_ci, ...
    weighing: str = "position_trace"  # how the own weight of an intersection is found, see FUSION_WEIGHTS
    prior_id: str = ""  # hash of a loaded map or shared survey that the start state rests on; "" for none
    common_origin: bool = True  # all maps began at one known point and heading; otherwise each peer's frame is found
    # Wideband: return to each peer what fusion made of its landmarks. It pays where some vehicles can't hear each other
    # (ends of a row of three: ATE 0.61 instead of 0.68 of that alone); it triples a pair's time and gains it nothing.
    feedback: bool = False
    relay: bool = False  # send peers' packets on, as they came, for those that can't hear them
    memory_landmarks: int = 40  # shared landmarks that are remembered after they have left the filter's state
    max_packet_landmarks: int = 64  # landmarks in one packet
    ratio: float = 0.8  # descriptor ratio test between vehicles, made before the gate
    gate_probability: float = 0.99  # of the chi-square gate on a common landmark
    min_common: int = 2  # pairs that must agree with each other before any is used
    floor_sigma_m: float = 0.3  # added to each packet landmark: descriptors do not meet on the very same point
    fleet_key_file: str = ""  # secret of 16 bytes or more that the fleet shares: packets without its tag are dropped
    signing_key_file: str = ""  # instead: this vehicle's own Ed25519 key (PEM)
    peer_keys_folder: str = ""  # with it: <vehicle>.pem, the public key of every vehicle

    def __post_init__(self) -> None:
        _require(self.mode in MODE_BUDGETS, self, "mode", f"one of {', '.join(MODE_BUDGETS)}")
        _require(self.budget_bytes_per_s >= 0, self, "budget_bytes_per_s", "a positive rate [B/s] or 0")
        _require(self.silent_after_s > 0, self, "silent_after_s", "a positive time [s]")
        _require(self.scheme in FUSION_SCHEMES, self, "scheme", f"one of {', '.join(FUSION_SCHEMES)}")
        _require(self.weighing in FUSION_WEIGHTS, self, "weighing", f"one of {', '.join(FUSION_WEIGHTS)}")
        _require(self.memory_landmarks >= 0, self, "memory_landmarks", "zero or more")
        _require(self.epoch_s > 0, self, "epoch_s", "a positive time [s]")
        _require(self.min_delay_s >= 0, self, "min_delay_s", "zero or more [s]")
        fits = 0 < self.max_packet_landmarks <= MAX_PACKET_LANDMARKS
        _require(fits, self, "max_packet_landmarks", f"a positive count of at most {MAX_PACKET_LANDMARKS}")
        _require(0 < self.ratio <= 1, self, "ratio", "a number in (0, 1]")
        _require(0 < self.gate_probability < 1, self, "gate_probability", "a probability in (0, 1)")
        _require(self.min_common >= 1, self, "min_common", "one or more")
        _require(self.floor_sigma_m >= 0, self, "floor_sigma_m", "zero or more [m]")
        one = not (self.fleet_key_file and self.signing_key_file)
        _require(one, self, "fleet_key_file", "either a fleet key or signing keys")
        pair = bool(self.signing_key_file) == bool(self.peer_keys_folder)
        _require(pair, self, "peer_keys_folder", "signing_key_file and peer_keys_folder together")

    @property
    def returns_feedback(self) -> bool:
        """Whether what fusion made of peers' landmarks is sent back to them: not where each byte counts."""
        return self.feedback and self.mode == "wideband"


START_METHODS = ("given", "static", "in_flight")


@dataclass(frozen=True, slots=True)
class StartConfig:
    """How a vehicle gets its start state."""

    method: str = "given"  # given: topic initial_state; static: gravity at rest; in_flight: gravity and stereo odometry
    rest_s: float = 1.0  # static: readings that are averaged [s]
    window_s: float = 1.0  # in_flight: frames that the start is found from [s]
    velocity_sigma: float = 5.0  # in_flight: doubt of the start's velocity that the filter is told, per axis [m/s]
    max_tilt_sigma_deg: float = 3.0  # in_flight: frames that leave roll and pitch more doubtful won't do [deg]

    def __post_init__(self) -> None:
        _require(self.method in START_METHODS, self, "method", f"one of {', '.join(START_METHODS)}")
        for key in ("rest_s", "window_s"):
            _require(getattr(self, key) > 0, self, key, "a positive time [s]")
        for key in ("velocity_sigma", "max_tilt_sigma_deg"):
            _require(getattr(self, key) > 0, self, key, "a positive standard deviation")


SIFT_EXTRACTORS = ("sift", "asift", "dsift")  # with descriptors of 128 bytes that look like SIFT's


@dataclass(frozen=True, slots=True)
class VehicleConfig:
    """Everything that one vehicle's nodes, or its offline twin, need besides calibration and start state."""

    start: StartConfig = field(default_factory=StartConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    rig: RigConfig = field(default_factory=RigConfig)
    frontend: FrontendConfig = field(default_factory=FrontendConfig)
    backend: BackendConfig = field(default_factory=BackendConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def __post_init__(self) -> None:
        fits = self.fusion.mode != "narrowband" or self.frontend.extractor in SIFT_EXTRACTORS
        allowed = f"one of {', '.join(SIFT_EXTRACTORS)} in narrowband mode, whose descriptors are made of SIFT's"
        _require(fits, self.frontend, "extractor", allowed)


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """What feeds the fleet.

    Attributes:
        bags: recordings that together hold every vehicle's topics.
        rate: multiple of real time; 0 paces by the graph's own progress (lock-step), so that no frame is lost.
        timeout_s: lock-step gives up when a vehicle has not answered for this long.
    """

    bags: tuple[Path, ...] = ()
    rate: float = 0.0
    timeout_s: float = 60.0

    def __post_init__(self) -> None:
        _require(self.rate >= 0, self, "rate", "0 (lock-step) or a positive multiple of real time")
        _require(self.timeout_s > 0, self, "timeout_s", "a positive time [s]")


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """A fleet description: vehicle configurations by name (the name is the ROS namespace), and what is replayed."""

    vehicles: dict[str, VehicleConfig]
    replay: ReplayConfig


def find_config(name: str) -> Path:
    """Return the file that a name stands for: a path, or the name of a file in this project's `config` folder.

    Raises:
        ConfigError: there is neither.
    """
    beside = Path(__file__).resolve().parents[1] / "config"
    prefixes = [
        Path(prefix) / "share/uav_vslam/config" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    ]
    candidates = [Path(name), *(folder / f"{name.removesuffix('.yaml')}.yaml" for folder in [beside, *prefixes])]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    known = ", ".join(sorted(file.stem for file in beside.glob("*.yaml")))
    raise ConfigError(f"configuration {name!r} is neither a file nor one of ours ({known})")


def find_link(name: str) -> Path:
    """Return the file of an emulated radio link: a path, or the name of a file in `config/links`.

    Raises:
        ConfigError: there is neither.
    """
    try:
        return find_config(name if Path(name).is_file() else f"links/{name}")
    except ConfigError:
        ours = find_config("links/clean").parent.glob("*.yaml")
        known = ", ".join(sorted(file.stem for file in ours))
        raise ConfigError(f"link {name!r} is neither a file nor one of ours ({known})") from None


def load_vehicle(path: Path | None, *, overrides: dict[str, Any] | None = None) -> VehicleConfig:
    """Read a vehicle's YAML file; keys that are absent keep their defaults.

    Args:
        path: YAML file, or None for pure defaults.
        overrides: {"backend.sigma_px": 0.5, ...}, applied last.

    Raises:
        ConfigError: the file can't be read, or a key or value is wrong.
    """
    tree = {} if path is None else _read_yaml(path)
    for dotted, value in (overrides or {}).items():
        section, _, key = dotted.partition(".")
        if isinstance(tree.setdefault(section, {}) or {}, dict):  # anything else is for `build` to refuse
            tree[section] = {**(tree[section] or {}), key: value}
    return typing.cast(VehicleConfig, build(VehicleConfig, tree, where=str(path or "overrides")))


def load_fleet(path: Path, *, overrides: dict[str, Any] | None = None) -> FleetConfig:
    """Read a fleet file: `vehicles: {uav1: {config: kagaru.yaml}}`, `replay: {bags: [...], rate: 0}`, `mode: wideband`.

    Paths in it are relative to the file; overrides such as {"backend.sigma_px": 0.5} reach every vehicle.

    Raises:
        ConfigError: the file can't be read, a key or value is wrong, or a vehicle's name is used twice.
    """
    tree = _read_yaml(path)
    known = {"vehicles", "replay", "mode"}
    _reject_unknown(set(tree), known, where=str(path), prefix="")
    if not isinstance(tree.get("vehicles"), dict) or not tree["vehicles"]:
        raise ConfigError(
            f"{path}: 'vehicles' must map at least one name to its settings, e.g. uav1: {{config: kagaru.yaml}}"
        )
    vehicles = {}
    for name, entry in tree["vehicles"].items():
        if not (isinstance(name, str) and name.isascii() and name.isidentifier()):
            raise ConfigError(
                f"{path}: vehicle name {name!r} must be a valid ROS namespace: letters, digits, underscores"
            )
        entry = entry or {}
        if not (isinstance(entry, dict) and isinstance(entry.get("config") or "", str)):
            raise ConfigError(f"{path}: vehicles.{name} = {entry!r} must look like {{config: kagaru.yaml}}")
        _reject_unknown(set(entry), {"config"}, where=str(path), prefix=f"vehicles.{name}.")
        file = path.parent / entry["config"] if entry.get("config") else None
        shared = {"fusion.mode": tree["mode"]} if "mode" in tree else {}
        vehicles[name] = load_vehicle(file, overrides={**shared, **(overrides or {})})
    replay_tree = tree.get("replay") or {}
    if not isinstance(replay_tree, dict):
        raise ConfigError(f"{path}: replay must hold keys and values, not {replay_tree!r}")
    bags = replay_tree.get("bags") or ()
    if not (isinstance(bags, list | tuple) and all(isinstance(bag, str) for bag in bags)):
        raise ConfigError(f"{path}: replay.bags = {bags!r} must be a list of paths, e.g. [flight]")
    replay_tree = {**replay_tree, "bags": tuple(path.parent / bag for bag in bags)}
    return FleetConfig(vehicles, build(ReplayConfig, replay_tree, where=f"{path}: replay"))


def load(cls: type, path: Path) -> Any:
    """Read one configuration class from a YAML file of its own.

    Raises:
        ConfigError: the file can't be read, or a key or value is wrong.
    """
    return build(cls, _read_yaml(path), where=str(path))


def build(cls: type, tree: Any, *, where: str, prefix: str = "") -> Any:
    """Build a (nested) configuration dataclass from plain YAML data.

    Raises:
        ConfigError: unknown key (with the nearest known one), wrong type, or a value that the class refuses.
    """
    if not isinstance(tree, dict):
        raise ConfigError(f"{where}: {prefix.rstrip('.') or 'the file'} must hold keys and values, not {tree!r}")
    hints = typing.get_type_hints(cls)
    _reject_unknown(set(tree), set(hints), where=where, prefix=prefix)
    values = {}
    for key, value in tree.items():
        hint = hints[key]
        if dataclasses.is_dataclass(hint):
            section = {} if value is None else value  # `backend:` with nothing below it changes nothing
            values[key] = build(typing.cast(type, hint), section, where=where, prefix=f"{prefix}{key}.")
        else:
            values[key] = _checked(value, hint, where=f"{where}: {prefix}{key}")
    try:
        return cls(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return {"backend.sigma_px": 1.0, ...} for a (nested) configuration dataclass."""
    flat: dict[str, Any] = {}
    for f in dataclasses.fields(config):
        value = getattr(config, f.name)
        if dataclasses.is_dataclass(value):
            flat.update(flatten(value, f"{prefix}{f.name}."))
        else:
            flat[prefix + f.name] = value
    return flat


def to_tree(config: Any) -> dict[str, Any]:
    """Return the resolved configuration as plain nested data, ready for YAML."""
    return typing.cast(dict[str, Any], _plain(dataclasses.asdict(config)))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _checked(value: Any, hint: Any, *, where: str) -> Any:
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, types.GenericAlias):  # tuple[Path, ...]
        return tuple(value)
    if not isinstance(value, hint) or (hint in {int, float} and isinstance(value, bool)):
        raise ConfigError(f"{where} = {value!r} must be of type {hint.__name__}")
    if hint is float and not math.isfinite(value):
        raise ConfigError(f"{where} = {value!r} must be finite")
    return value


def _reject_unknown(keys: set[Any], known: set[str], *, where: str, prefix: str) -> None:
    for key in sorted(map(str, keys - known)):
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean {prefix}{near[0]}?" if near else f"known keys: {', '.join(sorted(known))}"
        raise ConfigError(f"{where}: unknown key {prefix}{key}; {hint}")


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML silently lets a later key win; a vehicle named twice must not vanish like that."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise ConfigError(
                    f"{node.start_mark.name}: key {key!r} must be a word (line {key_node.start_mark.line + 1})"
                )
            if key in seen:
                raise ConfigError(
                    f"{node.start_mark.name}: key {key!r} is used twice (line {key_node.start_mark.line + 1})"
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        with path.open(encoding="utf-8") as stream:
            tree = yaml.load(stream, Loader=_UniqueKeyLoader)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror}); give the path of a YAML file") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid YAML ({error})") from None
    if tree is not None and not isinstance(tree, dict):
        raise ConfigError(f"{path}: must hold keys and values, not {type(tree).__name__}")
    return tree or {}
