"""Pictures of scans and of what was said of them: PNG, GIF, and recordings for the viewer Rerun (extra 'view')."""

from runtime.pictures.output import check_output, write_picture
from runtime.pictures.snapshot import Live, Snapshot, Stored, System, snapshots

__all__ = ["Live", "Snapshot", "Stored", "System", "check_output", "snapshots", "write_picture"]
