"""`mos live`: labels while a ROS 2 system runs."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from runtime.commands.options import (
    Bundle,
    Extrinsics,
    NoDeskew,
    Odometry,
    OdometryName,
    OwnSensor,
    RemissionScale,
    Threads,
    World,
    wrong_usage,
)
from runtime.commands.output import say, show_line
from runtime.commands.recordings import recording_options
from runtime.commands.runner_options import DEFAULTS, Body, Nearest, Providers, corners, provider, runner_settings

ENDS = (signal.SIGINT, signal.SIGTERM)


def live(
    topic: Annotated[str | None, typer.Option(help="Topic of the clouds.", show_default="the only one")] = None,
    pose_topic: Annotated[
        str | None, typer.Option(help="Topic of odometry that has the poses.", show_default="TF has them")
    ] = None,
    world: World = None,
    extrinsics: Extrinsics = None,
    odometry: Odometry = None,
    domain: Annotated[int, typer.Option(min=0, max=232, envvar="ROS_DOMAIN_ID", help="DDS domain.")] = 0,
    bundle: Bundle = None,
    sensor: OwnSensor = None,
    threads: Threads = 2,
    remission_scale: RemissionScale = None,
    no_deskew: NoDeskew = False,
    nearest: Nearest = DEFAULTS.nearest,
    body: Body = None,
    providers: Providers = None,
) -> None:
    """Label the clouds of a running ROS 2 system until Ctrl-C (extra 'live'). No installation of ROS is needed.

    TOPIC/labelled has the clouds with the fields moving and probability, TOPIC/static has them without what moves. Only
    the newest cloud counts: what comes while one is labelled is dropped.
    """
    options = recording_options(
        odometry,
        no_deskew,
        poses=None,
        calib=None,
        frame=None,
        topic=_named(topic),
        pose_topic=_named(pose_topic),
        world=world,
        extrinsics=extrinsics,
        remission_scale=remission_scale,
    )
    settings = runner_settings(
        threads=threads,
        sensor=sensor,
        deskew=not no_deskew,
        odometry=None if options.given_poses == "needed" else OdometryName.KISS.value,
        nearest=nearest,
        body=None if body is None else corners(body),
        providers=[provider(text) for text in providers or ()] or None,
        allow_fallback=False,
    )

    from runtime.live.dds import Node
    from runtime.live.session import Session
    from runtime.runner import MosRunner

    with told_to_end() as ending, Node(domain) as node, MosRunner(bundle, settings=settings) as runner:
        with wrong_usage():
            session = Session(node, runner, options)
        summary = session.run(ending.is_set, lambda one: say(one.text()))
    show_line(summary.text())


def _named(topic: str | None) -> str | None:
    """The whole name of a topic."""
    return None if topic is None else f"/{topic.strip('/')}"


@contextmanager
def told_to_end() -> Iterator[threading.Event]:
    """Within, Ctrl-C and what ends services set this, so that a scan is finished; the second time they end it all."""
    ending = threading.Event()

    def end(number: int, _: object) -> None:
        ending.set()
        signal.signal(number, before[signal.Signals(number)])

    before = {one: signal.signal(one, end) for one in ENDS}
    try:
        yield ending
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
