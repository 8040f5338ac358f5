"""Sensors of Ouster, by their data sheets."""

from runtime.sensors.sensor import Sensor, even

OS1_32 = Sensor("os1-32", even(21.2, -21.2, 32), 1024, range_noise=0.015, max_range=90.0, reach=200.0)
OS1_64 = Sensor("os1-64", even(16.6, -16.6, 64), 1024, range_noise=0.015, max_range=90.0, reach=200.0)
OS1_128 = Sensor("os1-128", even(21.2, -21.2, 128), 1024, range_noise=0.015, max_range=90.0, reach=200.0)
