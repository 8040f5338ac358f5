"""Cylinder3D on the processor: cells of a cylinder around the sensor, and the network over them."""
