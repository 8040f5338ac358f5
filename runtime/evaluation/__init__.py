"""Scores of predictions by the protocol of SemanticKITTI-MOS, and the archive that its server takes. NumPy only."""
