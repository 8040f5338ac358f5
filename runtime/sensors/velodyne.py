"""Sensors of Velodyne, by their manuals."""

from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import Sensor, even

# Two blocks of 32 lasers, 1/3 degree apart from +2 down and 1/2 degree apart from -8.83 down (HDL-64E S2 manual).
_HDL64E_BEAMS = tuple([2.0 - i / 3 for i in range(32)] + [-8.83 - i / 2 for i in range(32)])

HDL64E = Sensor(
    "hdl64e",
    _HDL64E_BEAMS,
    azimuth_steps=2083,  # 20,833 firings/s
    encoder_steps=4000,
    spin_tolerance=0.04,
    lifts=(0.203, 0.113),  # as calibrated: ros-drivers/velodyne, 64e_s2.1-sztaki
    self_hidden=True,
    image=RangeImage(),  # as published: SemanticKITTI's field of view
)
HDL32E = Sensor("hdl32e", even(10.67, -30.67, 32), 2170, range_noise=0.02, max_range=70.0, reach=100.0)
VLP16 = Sensor("vlp16", even(15.0, -15.0, 16), 1800, range_noise=0.02, max_range=100.0, reach=130.0, sensitivity=4e-6)
