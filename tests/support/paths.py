"""Where tests find their data."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # of the checkout
DATA = ROOT / "tests" / "data"
TINY = DATA / "tiny"  # checkpoint, bundle and scans: `python -m tests.support.make_tiny`
BUNDLE = TINY / "bundle"
PUBLISHED = DATA / "published"  # weights and outputs of the published networks
SHARED = ROOT.parent / "shared"  # real scans; not everywhere
KITTI = SHARED / "data" / "kitti" / "sequences"
