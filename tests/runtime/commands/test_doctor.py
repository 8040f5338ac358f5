"""`mos doctor`."""

import re

from runtime.commands.main import main
from tests.support.paths import BUNDLE


def test_doctor(folder, tmp_path, capsys):
    assert main(["doctor", str(folder), "--bundle", str(BUNDLE)]) in (0, 1)
    assert main(["doctor", str(folder), "--bundle", str(BUNDLE), "--pose-frame", "lidar"]) == 1
    shown = capsys.readouterr().out
    assert "use --pose-frame camera" in " ".join(shown.split())
    assert re.search(r"^bad +alignment", shown, re.MULTILINE)
