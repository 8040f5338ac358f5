"""The network, its training and the street simulator. `import mos_model` needs no torch."""
