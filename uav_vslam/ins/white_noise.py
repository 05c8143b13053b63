# SPDX-License-Identifier: Apache-2.0
"""The white noise of an inertial unit, measured from its readings in flight.

An IMU that is noisier than configured, as by vibration, makes gates too narrow and a right calibration look wrong.
Faster than an aircraft moves there is only noise. White noise is the same in both octaves of that band; vibration at
some frequencies is not, and averages out when readings are integrated, so the quieter octave counts. Noise that begins,
as when motors start, counts without what was measured before; noise that ends counts until it is forgotten.
"""

import dataclasses
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.config.settings import own_settings
from uav_vslam.ins.gaps import MISSING
from uav_vslam.types import NS_PER_S, ImuSample

Array = NDArray[np.float64]

SEGMENT = 64  # readings per spectrum
SEGMENTS = 8  # averaged: 2.6 s at 200 Hz
ONSET = 16  # readings that are enough to see noise begin, 0.08 s at 200 Hz
OCTAVES = (1 / 8, 1 / 4), (1 / 4, 1 / 2)  # of the sampling rate
NOISE_RATIO = 2.0  # measured over configured density: with half of the true one, NIS is up to four times too large
MOST = {name: one.at_most or np.inf for name, one in own_settings(ImuConfig).items()}  # that can be configured
ONSET_RATIO = 2.5  # of such readings over those before: right noise never had it in 10 000 times, but 2 in 20


class WhiteNoise:
    """Measures the noise of a stream of readings.

    Attributes:
        imu: as configured, but with the measured densities, of the noisiest axis, where they exceed NOISE_RATIO times
            those configured.
    """

    def __init__(self, configured: ImuConfig) -> None:
        self.imu = self._configured = configured
        self._segment: list[ImuSample] = []
        self._powers: deque[Array] = deque(maxlen=SEGMENTS)

    def add(self, sample: ImuSample, period_s: float) -> None:
        """Add a reading, later than those before, of a stream with a usual spacing [s]."""
        if not self._configured.noise_from_readings:
            return
        if self._segment and sample.stamp_ns - self._segment[-1].stamp_ns > MISSING * period_s * NS_PER_S:
            self._segment.clear()
        self._segment.append(sample)
        if len(self._segment) % ONSET:
            return
        if self._begins:
            self._powers.clear()
            del self._segment[:-ONSET]
        elif len(self._segment) < SEGMENT:
            return
        self._powers.append(_powers(self._segment))
        self._segment.clear()
        self.imu = self._measured()

    @property
    def _begins(self) -> bool:
        """Whether the newest readings are louder than those before."""
        if not self._powers:
            return False
        newest = _powers(self._segment[-ONSET:])
        return bool((_densities([newest]) > ONSET_RATIO * _densities(self._powers)).any())

    def _measured(self) -> ImuConfig:
        gyro, accel = _densities(self._powers).tolist()
        found, configured = {"gyro_noise": gyro, "accel_noise": accel}, self._configured
        louder: dict[str, Any] = {
            name: min(value, MOST[name])
            for name, value in found.items()
            if value > NOISE_RATIO * getattr(configured, name)
        }
        return dataclasses.replace(configured, **louder) if louder else configured


def _densities(powers: Iterable[Array]) -> Array:
    """Return (2,) noise densities of gyroscope and accelerometer by the powers of segments, see `_powers`."""
    octaves = np.sqrt(np.mean(list(powers), axis=0) / 2.0)  # a density is of both signs of a frequency
    return octaves.min(axis=0).reshape(2, 3).max(axis=1)


def octave_means(power: Array, shares: Array) -> Array:
    """Return (2, K) means over both octaves of power spectral densities (F, K) at (F,) shares of the sampling rate."""
    return np.array([power[(shares >= low) & (shares <= high)].mean(axis=0) for low, high in OCTAVES])


def _powers(segment: list[ImuSample]) -> Array:
    """Return (2, 6) one-sided power spectral densities of both octaves, of the gyroscope's and accelerometer's axes."""
    readings = np.array([[*sample.gyro.tolist(), *sample.accel_at_imu.tolist()] for sample in segment])
    readings -= readings.mean(axis=0)
    slope, window = np.linspace(-1.0, 1.0, len(segment)), np.hanning(len(segment))
    readings -= np.outer(slope, slope @ readings / (slope @ slope))
    rate_hz = (len(segment) - 1) * NS_PER_S / (segment[-1].stamp_ns - segment[0].stamp_ns)
    spectrum = np.fft.rfft(readings * window[:, None], axis=0)
    power = 2.0 * np.abs(spectrum) ** 2 / (rate_hz * (window @ window))
    return octave_means(power, np.fft.rfftfreq(len(segment)).astype(np.float64))
