# SPDX-License-Identifier: Apache-2.0
"""A setting is a dataclass field with its text, unit and range as metadata, from which it is checked.

    sigma_px: float = setting(1.0, "standard deviation of each pixel coordinate", unit="px", above=0, live=True)

From this one line come validation, the ROS parameter's descriptor and the reference page.
"""

import dataclasses
import difflib
import functools
import math
import typing
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uav_vslam.errors import ConfigError

Value = typing.TypeVar("Value")

# Sizes beyond which no unit in use makes sense, and squares and ratios of a few such numbers overflow or vanish.
SMALLEST, LARGEST = 1e-12, 1e10


@dataclass(frozen=True, slots=True)
class Setting:
    """The metadata of a setting.

    Attributes:
        text: its meaning, one line.
        unit: of a number; empty for none.
        above, at_least, below, at_most: range of a number, open or closed; None for no bound.
        choices: allowed texts; empty for any.
        live: it can change while the node runs.
        kind: declared type.
        default: value unless set.
    """

    text: str
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False
    kind: Any = None
    default: Any = None

    @property
    def description(self) -> str:
        """Text and unit."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text

    @property
    def range(self) -> str:
        """The allowed values, without the unit."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        words = {"above": self.above, "of at least": self.at_least, "below": self.below, "at most": self.at_most}
        bounds = " and ".join(f"{word} {bound:g}" for word, bound in words.items() if bound is not None)
        return f"{KINDS[self.kind]} {bounds}".strip()

    @property
    def allowed(self) -> str:
        """The allowed values, with the unit."""
        return f"{self.range} [{self.unit}]" if self.unit else self.range

    def accepted(self, value: Any) -> Any:
        """Return the value as the declared type: a whole number, or a text such as "1e-3", may stand for a float.

        Raises:
            ValueError: it has another type or is out of range; the text says what is allowed.
        """
        try:
            value = _converted(value, self.kind)
        except (ValueError, OverflowError):  # an integer beyond all floats
            raise ValueError(self.allowed) from None
        if any(map(_is_absurd, value if isinstance(value, tuple) else (value,))):
            raise ValueError(f"{self.allowed}, of a size from {SMALLEST:g} to {LARGEST:g}")
        outside = (
            (self.choices and value not in self.choices)
            or (self.above is not None and not value > self.above)
            or (self.at_least is not None and not value >= self.at_least)
            or (self.below is not None and not value < self.below)
            or (self.at_most is not None and not value <= self.at_most)
        )
        if outside:
            raise ValueError(self.allowed)
        return value


KINDS: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "a text",
    tuple[float, ...]: "a list of numbers",
    tuple[str, ...]: "a list of texts",
    tuple[Path, ...]: "a list of paths",
}


def setting(
    default: Value,
    text: str,
    *,
    unit: str = "",
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    choices: typing.Iterable[str] = (),
    live: bool = False,
) -> Value:
    """Declare a field of a configuration class; the arguments are the attributes of `Setting`."""
    described = Setting(text, unit, above, at_least, below, at_most, tuple(choices), live, default=default)
    return dataclasses.field(default=default, metadata={"setting": described})


class Settings:
    """Base of the configuration classes: on creation every value is checked and converted to its declared type."""

    __slots__ = ()

    def __post_init__(self) -> None:
        cls: type = type(self)
        for name, described in own_settings(cls).items():
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, described.accepted(value))
            except ValueError as error:
                refuse(name, value, str(error))
        self._check_together()

    def _check_together(self) -> None:
        """Refuse inconsistent combinations of values."""


def refuse(name: str, value: Any, allowed: str) -> typing.NoReturn:
    """Raise `ConfigError` for a value, saying what is allowed."""
    raise ConfigError(f"{name} = {value!r} is not allowed; use {allowed}")


def is_vehicle_name(name: object) -> bool:
    """Return whether a value can name a vehicle, and so its ROS namespace."""
    return isinstance(name, str) and name.isascii() and name.isidentifier()


@functools.cache
def own_settings(cls: Any) -> dict[str, Setting]:
    """Return the settings of a configuration class by name, without those of its sections."""
    hints = typing.get_type_hints(cls)
    return {
        f.name: dataclasses.replace(f.metadata["setting"], kind=hints[f.name])
        for f in dataclasses.fields(cls)
        if "setting" in f.metadata
    }


@functools.cache
def sections(cls: Any) -> dict[str, type]:
    """Return the classes of a configuration class's sections by name."""
    hints = typing.get_type_hints(cls)
    return {f.name: hints[f.name] for f in dataclasses.fields(cls) if dataclasses.is_dataclass(hints[f.name])}


def all_settings(cls: type, prefix: str = "") -> dict[str, Setting]:
    """Return the settings of a class and its sections by dotted name ("backend.sigma_px")."""
    found = {prefix + name: described for name, described in own_settings(cls).items()}
    for name, section in sections(cls).items():
        found |= all_settings(section, f"{prefix}{name}.")
    return found


def flatten(config: Any) -> dict[str, Any]:
    """Return the values of a configuration by dotted name."""
    return {name: functools.reduce(getattr, name.split("."), config) for name in all_settings(type(config))}


def differences(config: Any) -> dict[str, Any]:
    """Return the values that differ from the defaults, by dotted name, as plain data."""
    defaults = flatten(type(config)())
    return {name: plain(value) for name, value in flatten(config).items() if value != defaults[name]}


def plain(value: Any) -> Any:
    """Return a value as YAML, JSON and ROS parameters have it: lists for tuples, text for paths."""
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def replaced(config: Value, changes: Mapping[str, Any], *, where: str) -> Value:
    """Return a configuration with some values, by dotted name, changed.

    Raises:
        ConfigError: an unknown name, or a value that is not allowed, alone or with the others.
    """
    return build(type(config), flatten(config) | dict(changes), where=where)


def build(cls: type[Value], values: Mapping[str, Any], *, where: str) -> Value:
    """Make a configuration from values by dotted name; those absent keep their defaults.

    Raises:
        ConfigError: an unknown name (with the nearest known one), or a value that is not allowed.
    """
    check_names(values, cls, where=where)
    try:
        return typing.cast(Value, _built(cls, values, ""))
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def check_names(values: Mapping[str, Any], *classes: type, where: str, beside: Collection[str] = ()) -> None:
    """Refuse names that are settings of none of the classes.

    Args:
        values: by dotted name.
        classes: whose settings are allowed.
        where: file, for the error.
        beside: keys of the same file that are read apart, for the error.

    Raises:
        ConfigError: a name is unknown, with the nearest known one or all of the top level.
    """
    known = {name for cls in classes for name in all_settings(cls)}
    parts = {name.partition(".")[0] for name in known if "." in name}
    for name, value in values.items():
        if name in parts and value not in (None, {}):
            if isinstance(value, dict):
                one = f"{name}.{next(iter(value))}"
                raise ConfigError(f"{where}: {name} is a group of settings; give each by its name, as {one}")
            raise ConfigError(f"{where}: {name} must hold keys and values, not {value!r}")
        if name not in known | parts:
            raise ConfigError(f"{where}: unknown key {name}; {_hint(name, known, parts | set(beside))}")


def _hint(name: str, known: set[str], parts: set[str]) -> str:
    same_end = [key for key in sorted(known) if key.endswith(f".{name}")]
    top = parts | {key for key in known if "." not in key}
    near = difflib.get_close_matches(name, sorted(known | parts), n=1) or same_end
    return f"did you mean {near[0]}?" if near else f"known keys: {', '.join(sorted(top))}"


def _built(cls: type, values: Mapping[str, Any], prefix: str) -> Any:
    inner = {name: _built(section, values, f"{prefix}{name}.") for name, section in sections(cls).items()}
    own = {name: values[prefix + name] for name in own_settings(cls) if prefix + name in values}
    try:
        return cls(**inner, **own)
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from None


def flattened(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of everything in nested data; an empty section as itself."""
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _converted(value: Any, kind: Any) -> Any:
    """Return a value as a type; ValueError if it can't be converted."""
    if typing.get_origin(kind) is tuple:
        if not isinstance(value, list | tuple):
            raise ValueError
        item = typing.get_args(kind)[0]
        return tuple(_converted(one, item) for one in value if one != "")  # ROS can't type an empty list: [""]
    if kind is Path and isinstance(value, str | Path):
        return Path(value)
    if kind is float and isinstance(value, int | str) and not isinstance(value, bool):
        value = float(value)  # YAML reads 1e-3 as text
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ValueError
    if kind is float and not math.isfinite(value):
        raise ValueError
    return value


def _is_absurd(value: Any) -> bool:
    return isinstance(value, float) and value != 0 and not SMALLEST <= abs(value) <= LARGEST
