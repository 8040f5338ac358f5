"""Sensors of RoboSense, by their manuals."""

from runtime.sensors.sensor import Sensor, even

# Dense around the horizon: 1/3 degree (RS-LiDAR-32), 0.1 degree (RS-Ruby).
_RS32_BEAMS = (
    *(15.0, 10.333, 7.0, 4.667, 3.333, 2.333),
    *even(1.667, -4.667, 20),
    *(-5.407, -6.424, -7.91, -10.281, -14.638, -25.0),
)
_RUBY_BEAMS = (
    *(15.0, 11.5, 9.0, 7.41, 6.56, 5.96, 5.46, 5.06, 4.71, 4.41, 4.16, 3.96),
    *even(3.81, -6.39, 103),
    *(-6.5, -6.65, -6.85, -7.15, -7.65, -8.352, -9.244, -10.346, -11.742, -13.565, -16.042, -19.582, -25.0),
)

RS16 = Sensor(
    "rs16", even(15.0, -15.0, 16), 1800, min_range=0.4, range_noise=0.02, max_range=100.0, reach=150.0,
    sensitivity=4e-6,
)  # fmt: skip
RS32 = Sensor(
    "rs32", _RS32_BEAMS, 1800, min_range=0.4, range_noise=0.03, max_range=110.0, reach=200.0, sensitivity=2e-6
)
RUBY = Sensor(
    "ruby", _RUBY_BEAMS, 1800, min_range=0.4, range_noise=0.03, max_range=110.0, reach=250.0, sensitivity=1e-6
)
