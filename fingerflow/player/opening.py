"""Opening of a stream: from the options of the player to a `Player` with source, engine, outputs and results folder."""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fingerflow.engines.bundle import load_bundle
from fingerflow.engines.choice import engine_of_stream
from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.kernels.kernel import set_threads, threads
from fingerflow.player.addresses import open_address
from fingerflow.player.condition import Condition
from fingerflow.player.handover import Slot
from fingerflow.player.live_forces import FrameForces, LiveForces, SensorForces
from fingerflow.player.live_values import LiveValues
from fingerflow.player.logged_warnings import log, logged_warnings
from fingerflow.player.options import OUTPUTS, SENSORS
from fingerflow.player.outputs.callback_output import CallbackOutput, OnFrame
from fingerflow.player.played import choose_input
from fingerflow.player.records import RecordLayout
from fingerflow.player.sending import Destination
from fingerflow.player.stream_player import Player, Settings
from fingerflow.player.stream_scene import contradictions, find_topography, stated_threshold, stream_settings
from fingerflow.results.stream_folder import RESULTS_FORMAT, Sink
from fingerflow.schema.bundle_format import COORDINATES
from fingerflow.tracker.frame_tracker import StreamTracker

ReadForces = Callable[[Path], LiveForces | None]


def open_player(options: Namespace, forces_of: ReadForces | None = None, on_frame: OnFrame | None = None) -> Player:
    """Open the bundle, frame source, force sensor, outputs and results folder that the options name, and return a
    player that is ready to run.

    Args:
        options: of `option_parser`; the camera may be a factory instead of its name.
        forces_of: reads the forces that a scene file names; the player alone cannot read them.
        on_frame: called with every frame, beside the outputs of the options.

    Raises FingerflowError for all that the user can correct.
    """
    with logged_warnings() as warnings:
        # By default Python lets a thread run for 5 ms before it switches to another: the time budget of a frame.
        sys.setswitchinterval(5e-4)
        bundle = load_bundle(options.bundle)
        played = choose_input(options, bundle)
        scene, name = played.scene, played.name
        for warning in contradictions(scene, bundle.recipe):
            log.warning("%s", warning)
        # Leave one core to the other threads: reading frames, results of the previous frame, the page.
        set_threads(options.threads or max(1, threads() - 1))
        if options.engine == "native" and options.provider is not None:
            raise PlayerError(
                "--provider is of ONNX Runtime, and the engine native computes on the processor; leave it out, or take "
                "--engine onnx"
            )
        of_stream = options.engine if options.provider is None else "onnx"
        engine = engine_of_stream(bundle, of_stream, options.provider, options.threads or 1)
        tracker = StreamTracker(engine, stream_settings(scene, bundle), played.glass, played.dark)
        tracker.warm_up(Slot(bundle, scene))
        named = options.output or scene.stream.output
        folder = named or Path(f"results-{datetime.now():%Y%m%d-%H%M%S}")
        live = options.camera is not None
        process_all = options.policy == "every" if options.policy else not live
        settings = Settings(
            process_all=process_all,
            queue=options.queue if process_all else 1,
            rate=options.rate or (None if live else scene.recording.frame_rate),
            frames=min((count for count in (options.frames, played.frames) if count is not None), default=None),
            give_up=options.give_up,
            page=options.page,
        )
        lens = tracker.geometry.lens
        header: dict[str, Any] = {
            "format": RESULTS_FORMAT,
            "started": datetime.now(UTC).isoformat(),
            "fingerflow": bundle.version,
            "recipe": bundle.recipe,
            "graph_sha256": bundle.hashes,
            "engine": engine.described,
            "source": name,
            "policy": "every" if process_all else "latest",
            "mm_per_px": scene.calibration.mm_per_px,
            "topography_to_contact": scene.calibration.topography_to_contact,
            **({"lens": asdict(lens), "topography": asdict(find_topography(scene))} if lens else {}),
            "threshold": "measured" if tracker.measures else stated_threshold(scene),
            "coordinates": COORDINATES,
            "warnings": warnings,
        }
        with ExitStack() as opened:  # closes what was opened if a later part cannot be opened
            forces: FrameForces | None = None
            if options.forces is not None:
                forces = SensorForces(open_address(SENSORS, "force sensor", options.forces), options.forces)
                opened.callback(forces.close)
            elif played.forces_in is not None and forces_of is not None:
                forces = forces_of(played.forces_in)
            layout = RecordLayout(bundle.points, forces.names if forces else ())
            header |= {"record_bytes": layout.dtype.itemsize, "fields": layout.fields}
            sink = Sink(folder, header, numbered=named is None)
            values = LiveValues(layout)
            destinations = []
            for destination in _destinations(options, values, on_frame):
                opened.callback(destination.output.close)
                destinations.append(destination)
            try:
                source = played.open_source(played.first)
            except FingerflowError:
                raise
            except (Exception, SystemExit) as error:
                raise PlayerError(f"{name}: cannot be opened ({type(error).__name__}: {first_line(error)})") from error
            opened.pop_all()
        return Player(
            tracker, engine.described, bundle, played, source, sink, layout, settings, forces, values, destinations
        )


def _destinations(options: Namespace, values: LiveValues, on_frame: OnFrame | None) -> Iterator[Destination]:
    """Open and yield one after another the outputs of live values: the function `on_frame` if there is one, those of
    `--send`, and those of `--then` with their conditions.
    """
    if len(options.when) != len(options.then):
        raise PlayerError(
            f"{len(options.when)} --when and {len(options.then)} --then: give one --then after each --when"
        )
    units = values.value_units(options.values)
    if on_frame is not None:
        yield Destination("on_frame", CallbackOutput(on_frame), tuple(units))
    for address in options.send:
        yield Destination(address, open_address(OUTPUTS, "output", address, units), tuple(units))
    for text, address in zip(options.when, options.then, strict=True):
        condition = Condition(text, values.variables)
        log.info("trigger: %s (%s)", text, values.variables[condition.name].long_name)
        output = open_address(OUTPUTS, "output", address, units)
        yield Destination(f"{address} when {text}", output, tuple(units), condition)
