"""Sensors of Velodyne, by their manuals."""

from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import Sensor, even

# Two blocks of 32 lasers, 1/3 degree apart from +2 down and 1/2 degree apart from -8.83 down (HDL-64E S2 manual).
_HDL64E_BEAMS = tuple([2.0 - i / 3 for i in range(32)] + [-8.83 - i / 2 for i in range(32)])
# Dense around the horizon: 1/3 degree (VLP-32C manual, table 9-1), 0.11 degree (Alpha Prime manual).
_VLP32C_BEAMS = (
    *(15.0, 10.333, 7.0, 4.667, 3.333, 2.333),
    *even(1.667, -4.0, 18),
    *(-4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639, -25.0),
)
_VLS128_BEAMS = (
    *(15.0, 11.75, 9.7, 8.43, 7.58, 6.98, 6.48, 6.08, 5.73, 5.43, 5.18, 4.98, 4.83),
    *even(4.72, -6.5, 103),
    *(-6.65, -6.85, -7.15, -7.65, -8.352, -9.244, -10.346, -11.742, -13.565, -16.042, -19.582, -25.0),
)

HDL64E = Sensor(
    "hdl64e",
    _HDL64E_BEAMS,
    azimuth_steps=2083,  # 20,833 firings/s
    encoder_steps=4000,
    spin_tolerance=0.04,
    reach=130.0,  # 120 m of what reflects well
    lifts=(0.203, 0.113),  # as calibrated: ros-drivers/velodyne, 64e_s2.1-sztaki
    self_hidden=True,
    image=RangeImage(),  # as published: SemanticKITTI's field of view
)
HDL32E = Sensor("hdl32e", even(10.67, -30.67, 32), 2170, range_noise=0.02, max_range=70.0, reach=100.0)
VLP16 = Sensor(
    "vlp16", even(15.0, -15.0, 16), 1800, min_range=0.5, range_noise=0.02, max_range=100.0, reach=130.0,
    sensitivity=4e-6,
)  # fmt: skip
VLP32C = Sensor(
    "vlp32c", _VLP32C_BEAMS, 1808, min_range=0.5, range_noise=0.03, max_range=110.0, reach=200.0, sensitivity=2e-6
)
VLS128 = Sensor(
    "vls128", _VLS128_BEAMS, 1876, min_range=0.5, range_noise=0.03, max_range=110.0, reach=300.0, sensitivity=1e-6
)
