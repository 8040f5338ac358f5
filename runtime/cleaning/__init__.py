"""Recordings without what moves in them, and the map that is left."""
