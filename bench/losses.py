"""What is lost with a machine of a cluster, or with the process that gives the work: `python -m bench.losses`.

Several machines are several nodes of Ray on this one: all processes of a node are killed at once.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from bench.report import save, show
from runtime.commands.handler import need_extra, run_alone
from runtime.fleet.here import label_here
from runtime.fleet.wanted import Wanted
from runtime.fleet.work import settle
from runtime.recordings.recording import Options
from runtime.recordings.searching import search_recordings
from runtime.sensors.velodyne import VLP16
from runtime.settings import RunnerSettings

LONGEST = 600.0  # s of a run
MEMORY = 80 << 20  # bytes of each node's store


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    rounds: Annotated[int, typer.Option(help="Of each kind of loss")] = 10,
    recordings: int = 20,
    scans: Annotated[int, typer.Option(help="Of a recording, by a simulated VLP-16")] = 12,
    piece: Annotated[int | None, typer.Option(help="As of `mos run`", show_default="whole")] = None,
    seed: int = 0,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """One recording is broken. Labels beside those of one process, files that are left over, exit codes."""
    need_extra("fleet", "ray")
    from mos_model.simulator.write import write_dataset

    chance, rows = random.Random(seed), dict[str, dict[str, Any]]()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_dataset(root / "logs", recordings, scans, seed, VLP16.name)
        broken = root / "logs/sequences/03/velodyne/000005.bin"
        broken.write_bytes(broken.read_bytes()[:-5])
        whole = _one_process(root, bundle)
        command = [sys.executable, "-m", "runtime.commands.start", "run", str(root / "logs"), "--on", "ray"]
        command += ["--threads", "1", *(["--piece", str(piece)] if piece else [])]
        command += ["--bundle", str(bundle.absolute())] if bundle else []
        with _Cluster() as cluster:
            for name, lose in {"a node is lost": _lose_node, "the driver is lost": _lose_driver}.items():
                found = [_round(root, command, cluster, lose, chance, whole) for _ in range(rounds)]
                rows[name] = {
                    "rounds": rounds,
                    "labels": len(whole) * rounds,
                    "other than of one process": sum(one["differ"] for one in found),
                    "missing": sum(one["missing"] for one in found),
                    "temporary files": sum(one["left"] for one in found),
                    "exit code 1": sum(one["code"] == 1 for one in found),
                    "broken one named": sum(one["named"] for one in found),
                    "seconds": round(sum(one["seconds"] for one in found), 1),
                }
    show(f"{recordings} recordings of {scans} scans, one broken, on two nodes of Ray", rows)
    save(out, 1, {"recordings": recordings, "scans": scans, "piece": piece, "seed": seed, "losses": rows})


def _one_process(root: Path, bundle: Path | None) -> dict[str, bytes]:
    """Every label as one process writes it, by its path."""
    out = root / "one"
    work = settle(bundle, RunnerSettings(threads=1), Options(), out, False, Wanted())
    label_here(work, search_recordings([root / "logs"]), hear=lambda event: None)
    return _labels(out)


def _labels(out: Path) -> dict[str, bytes]:
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*.label")}


def _round(
    root: Path,
    command: list[str],
    cluster: "_Cluster",
    lose: Callable[..., subprocess.Popen[str]],
    chance: random.Random,
    whole: dict[str, bytes],
) -> dict[str, Any]:
    """Run, lose something at a random moment, and look at what is there."""
    out, begun = root / "out", time.perf_counter()
    shutil.rmtree(out, ignore_errors=True)
    cluster.fill()

    def start() -> subprocess.Popen[str]:
        environment = os.environ | {"RAY_ADDRESS": cluster.address}
        return subprocess.Popen(
            [*command, "--out", str(out)], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    running = start()
    moment = chance.randrange(1, len(whole))
    while len(list(out.rglob("*.label"))) < moment and running.poll() is None:
        time.sleep(0.01)
    time.sleep(chance.uniform(0, 0.1))
    running = lose(running, start, cluster, chance)
    said, _ = running.communicate(timeout=LONGEST)
    found = _labels(out)
    result = {
        "differ": sum(found[path] != data for path, data in whole.items() if path in found),
        "missing": len(whole.keys() - found.keys()) + len(found.keys() - whole.keys()),
        "left": len([path for path in out.rglob(".*")]),
        "code": running.returncode,
        "named": "1 of" in said and "03 (stopped at scan 000005" in said,
        "seconds": time.perf_counter() - begun,
    }
    Console().print(f"lost after {moment} labels: {result}", highlight=False, soft_wrap=True)
    if result["code"] != 1 or not result["named"] or result["differ"] or result["missing"] or result["left"]:
        Console(stderr=True).print(said, markup=False)
    return result


def _lose_node(running: Any, start: Any, cluster: "_Cluster", chance: random.Random) -> Any:
    cluster.kill(chance.randrange(2))
    return running


def _lose_driver(running: Any, start: Any, cluster: "_Cluster", chance: random.Random) -> Any:
    running.kill()
    running.communicate()
    return start()


class _Cluster:
    """A head without processors, and two nodes with one each."""

    def __enter__(self) -> "_Cluster":
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        os.environ["PYTHONPATH"] = os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
        from ray.cluster_utils import Cluster

        self._cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "object_store_memory": MEMORY})
        self.address = self._cluster.address
        self._nodes: list[Any] = []
        return self

    def __exit__(self, *_: object) -> None:
        self._cluster.shutdown()

    def fill(self) -> None:
        """Two nodes, whatever was lost before."""
        while len(self._nodes) < 2:
            self._nodes.append(self._cluster.add_node(num_cpus=1, object_store_memory=MEMORY))

    def kill(self, number: int) -> None:
        """A node, with all that runs on it."""
        node = self._nodes.pop(number)
        (raylet,) = (one.process.pid for one in node.all_processes["raylet"])
        for process in [raylet, *_below(raylet)]:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self._cluster.remove_node(node, allow_graceful=False)


def _below(process: int) -> list[int]:
    """Processes that it started, and those that they did."""
    found, above = [process], dict[int, int]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it is gone
            above[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    for one in found:
        found += [child for child, parent in above.items() if parent == one]
    return found[1:]


if __name__ == "__main__":
    sys.exit(run_alone(bench, "losses"))
