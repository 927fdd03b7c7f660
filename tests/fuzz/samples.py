"""Small real files of every format that is read, written by the libraries of these formats."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

COUNT, HEIGHT, WIDTH = 6, 24, 32
_RNG = np.random.default_rng(16)
GREY8 = _RNG.integers(0, 256, (COUNT, HEIGHT, WIDTH)).astype(np.uint8)
GREY16 = (_RNG.integers(0, 4096, (COUNT, HEIGHT, WIDTH))).astype(np.uint16)
TIMES = np.arange(60) / 1000
COLUMNS = {"time": TIMES, "normal": np.linspace(0, 5, 60), "tangential": np.sin(40 * TIMES)}


@dataclass(frozen=True)
class Sample:
    """Files by name: `damaged` is the name of the file to damage, `opened` the name that the reader opens ("." for the
    folder).
    """

    files: dict[str, bytes]
    damaged: str
    opened: str


def samples(reader: str, folder: Path) -> list[Sample]:
    """Make the samples of a reader in `folder`, which is empty, and return them."""
    return _MAKERS[reader](folder)


def _one(path: Path) -> Sample:
    return Sample({path.name: path.read_bytes()}, path.name, path.name)


def _npy(folder: Path) -> list[Sample]:
    found = []
    for number, frames in enumerate((GREY8, np.asfortranarray(GREY16), GREY16.astype(">f4"), GREY8[0])):
        np.save(folder / f"{number}.npy", frames)
        found.append(_one(folder / f"{number}.npy"))
    return found


def _tiff(folder: Path) -> list[Sample]:
    import tifffile

    options: list[dict[str, object]] = [
        {}, {"imagej": True, "metadata": {"axes": "TYX", "finterval": 0.004}}, {"bigtiff": True},
        {"compression": "zlib"}, {"rowsperstrip": 7}, {"tile": (16, 16)}, {"byteorder": ">"}, {"metadata": None},
    ]  # fmt: skip
    for number, option in enumerate(options):
        tifffile.imwrite(folder / f"{number}.tif", GREY16, photometric="minisblack", **option)
    with tifffile.TiffWriter(folder / "pages.tif") as writer:
        for frame in GREY8:
            writer.write(frame, photometric="minisblack", metadata=None, contiguous=False)
    tifffile.imwrite(folder / "one.tif", GREY8[0], software="caméra".encode("latin-1"))
    tifffile.imwrite(folder / "ome.ome.tif", GREY8, metadata={"axes": "TYX"})
    return [_one(path) for path in sorted(folder.iterdir())]


def _hdf5(folder: Path) -> list[Sample]:
    import h5py

    for number, (version, layout) in enumerate(
        (version, layout)
        for version in ("earliest", "latest")
        for layout in ({}, {"chunks": (2, HEIGHT, WIDTH), "compression": "gzip", "shuffle": True, "fletcher32": True})
    ):
        with h5py.File(folder / f"{number}.h5", "w", libver=version) as file:
            file.create_dataset("trial/frames", data=GREY16, **layout)
            file["trial/frames"].attrs.update({"frame_rate": 300.0, "bit_depth": 12})
            file["trial/note"] = "a text"
            file["force"] = np.zeros(40)
            file["same"] = h5py.SoftLink("/trial/frames")
    with h5py.File(folder / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout((COUNT, HEIGHT, WIDTH), "u2")
        layout[:] = h5py.VirtualSource(folder / "0.h5", "trial/frames", (COUNT, HEIGHT, WIDTH))
        file.create_virtual_dataset("frames", layout)
    return [_one(path) for path in sorted(folder.iterdir())]


def _cine(folder: Path) -> list[Sample]:
    from tests.recordings.camera_files import Cine, pack_bits

    stamps = [number / 300 for number in range(COUNT)]
    codes = GREY16 >> 2
    kinds = {
        "8": Cine(WIDTH, HEIGHT, [frame.tobytes() for frame in GREY8], 8, setup={"RealBPP": 8}),
        "16": Cine(WIDTH, -HEIGHT, [frame.tobytes() for frame in GREY16], stamps=stamps, annotation=b"a note"),
        "10": Cine(WIDTH, HEIGHT, [pack_bits(frame, 10) for frame in codes], packing=256, stamps=stamps),
        "12": Cine(WIDTH, HEIGHT, [pack_bits(frame, 12) for frame in GREY16], packing=1024, setup_length=1000),
    }
    return [_one(cine.write(folder / f"{name}.cine")) for name, cine in kinds.items()]


def _mraw(folder: Path) -> list[Sample]:
    from tests.recordings.camera_files import pack_bits, write_photron

    packed = b"".join(pack_bits(frame, 12) for frame in GREY16)
    found = []
    for suffix, bits, pixels in ((".cih", 16, GREY16.tobytes()), (".cih", 12, packed), (".cihx", 16, GREY16.tobytes())):
        path = write_photron(folder, pixels, suffix, Color_Bit=bits, Image_Width=WIDTH, Image_Height=HEIGHT)
        header = path.with_suffix(suffix)
        files = {header.name: header.read_bytes(), path.name: pixels}
        found += [Sample(files, header.name, path.name), Sample(files, header.name, header.name)]
    return [*found, Sample(files, path.name, path.name)]


def _video(folder: Path) -> list[Sample]:
    from tests.recordings.camera_files import write_video

    for name, codec, pixels in (
        ("a.avi", "rawvideo", "gray"),
        ("a.mkv", "ffv1", "gray"),
        ("b.avi", "ffv1", "gray16le"),
        ("a.mp4", "libx264", "yuv420p"),
        ("a.mov", "png", "gray"),
        ("b.mkv", "libx264", "yuv420p"),
        ("c.avi", "mjpeg", "yuvj420p"),
    ):
        frames = GREY16 if pixels == "gray16le" else GREY8
        write_video(folder / name, frames, codec, pixels, threads="1")
    return [_one(path) for path in sorted(folder.iterdir())]


def _images(folder: Path) -> list[Sample]:
    import cv2
    import tifffile

    found = []
    for suffix, frames in ((".png", GREY8), (".png", GREY16), (".bmp", GREY8), (".jpg", GREY8)):
        files = {f"{n}{suffix}": cv2.imencode(suffix, frame)[1].tobytes() for n, frame in enumerate(frames[:3])}
        found += [
            Sample(files, f"0{suffix}", "."),
            Sample(files, f"1{suffix}", "."),
            Sample(files, f"2{suffix}", f"2{suffix}"),
        ]
    tifffile.imwrite(folder / "0.tif", GREY16[0])
    return [*found, Sample({"0.tif": (folder / "0.tif").read_bytes()}, "0.tif", ".")]


def _forces_text(folder: Path) -> list[Sample]:
    rows = list(zip(*COLUMNS.values(), strict=True))
    comma = "time (s),normal (N),tangential (N)\n" + "".join("{:.6g},{:.6g},{:.6g}\n".format(*row) for row in rows)
    german = comma.replace(",", ";").replace(".", ",")
    units = "time\tnormal\ttangential\ns\tN\tmN\n" + comma.partition("\n")[2].replace(",", "\t")
    texts = {"a.csv": comma, "b.csv": german, "a.tsv": units, "a.txt": "# a note\n" + comma.replace(",", " ")}
    return [Sample({name: text.encode()}, name, name) for name, text in texts.items()]


def _forces_hdf5(folder: Path) -> list[Sample]:
    import h5py

    for version in ("earliest", "latest"):
        with h5py.File(folder / f"{version}.h5", "w", libver=version) as file:
            for name, values in COLUMNS.items():
                file.create_dataset(f"trial/{name}", data=values, **({} if name == "time" else {"compression": "gzip"}))
                file[f"trial/{name}"].attrs["units"] = "s" if name == "time" else "N"
            file["note"] = "a text"
    return [_one(path) for path in sorted(folder.iterdir())]


def _forces_matlab(folder: Path) -> list[Sample]:
    import h5py
    import scipy.io

    units = {"normal": "N", "tangential": "N"}
    ragged = np.empty(2, object)
    ragged[:] = [np.zeros(3), np.zeros((2, 2))]
    scipy.io.savemat(folder / "plain.mat", COLUMNS | {"units": units})
    scipy.io.savemat(folder / "packed.mat", {"trial": COLUMNS | {"units": units}}, do_compression=True)
    scipy.io.savemat(folder / "cells.mat", COLUMNS | {"units": units, "cells": ragged})
    scipy.io.savemat(folder / "old.mat", COLUMNS, format="4")
    with h5py.File(folder / "new.mat", "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[name] = values[:, None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(folder / "new.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124, b" ") + b"\x00\x02IM")
    return [_one(path) for path in sorted(folder.iterdir())]


def _forces_tdms(folder: Path) -> list[Sample]:
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 0.001, "wf_start_offset": 0.0, "unit_string": "N"}
    with TdmsWriter(folder / "a.tdms") as writer:
        channels = [ChannelObject("forces", name, COLUMNS[name], clock) for name in ("normal", "tangential")]
        writer.write_segment(channels)
        writer.write_segment(channels)
    return [_one(folder / "a.tdms")]


def _calibration(folder: Path) -> list[Sample]:
    from fingerflow.calibration import Calibration, Disc, Transform
    from fingerflow.schema.views import View

    disc = Disc((12.5, 13.0), (5.0, 5.0), 0.0, 0.1, 0.1, 1.0, 0.5, 20.0)
    residuals = np.array([[0.1, 0.0], [0.0, 0.1], [0.1, 0.1]])
    transform = Transform(np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 4.0]]), residuals)
    views = {"contact": View((0, 24), (32, 64)), "topography": View((0, 24), (0, 32))}
    text = Calibration(0.02, 2.75, disc, views, ((disc, disc),), transform, transform).to_toml()
    return [Sample({"calibration.toml": text.encode()}, "calibration.toml", "calibration.toml")]


def _scene(folder: Path) -> list[Sample]:
    from fingerflow.schema.scene_template import scene_text
    from fingerflow.schema.views import View

    (calibration,) = _calibration(folder)
    np.save(folder / "a.npy", GREY8)
    views = {"contact": View((0, 24), (32, 64)), "topography": View((0, 24), (0, 32))}
    text = scene_text(
        frames="a.npy", background="a.npy", frame_rate=300.0, forces="forces.csv", trigger_frame=1, **views
    )
    files = calibration.files | {
        "scene.toml": text.encode(),
        "a.npy": (folder / "a.npy").read_bytes(),
        "forces.csv": _forces_text(folder)[0].files["a.csv"],
    }
    return [Sample(files, "scene.toml", "scene.toml")]


def _bundle(folder: Path) -> list[Sample]:
    """Return samples of a bundle with its scene, the picture of the empty glass and frames to play."""
    from tests.player.tiny_bundle import frame, write_bundle, write_scene

    write_bundle(folder / "bundle")
    write_scene(folder / "bundle" / "scene.toml", '[recording]\nframes = "frames.npy"\nframe_rate = 300.0')
    np.save(folder / "bundle" / "frames.npy", np.stack([frame(10 - k // 3, 40 * k, k / 4) for k in range(6)]))
    files = {path.name: path.read_bytes() for path in (folder / "bundle").iterdir()}
    return [
        Sample(files, name, ".")
        for name in ("bundle.json", "bundle.json", "scene.toml", "scene.toml", "empty.npy", "frames.npy")
    ]


def _result(folder: Path) -> list[Sample]:
    import xarray as xr

    from fingerflow.results.result import save_result

    frames = {"time": ("frame", TIMES, {"units": "s"}), "frame": np.arange(60)}
    values = {
        "real_contact_area": ("frame", COLUMNS["normal"], {"units": "mm2", "long_name": "area"}),
        "position": (("frame", "point", "xy"), np.zeros((60, 5, 2)), {"units": "mm"}),
    }
    attributes = {"fingerflow_version": "0.1.0", "warnings": "[]", "settings": "{}", "mm_per_px": 0.02}
    save_result(xr.Dataset(values, {**frames, "xy": ["x", "y"]}, attributes), folder / "result.h5")
    return [_one(folder / "result.h5")]


def _stream(folder: Path) -> list[Sample]:
    """Return samples of the results folder that playing the bundle leaves."""
    from tests.fuzz.__main__ import play

    _bundle(folder)
    files = {path.name: path.read_bytes() for path in play(folder / "bundle").iterdir()}
    return [Sample(files, name, ".") for name in ("header.json", "header.json", "events.jsonl", "records.bin")]


def _played(folder: Path) -> list[Sample]:
    """Return samples of recordings that the player of a bundle reads by itself."""
    return [*_npy(folder), *_images(folder)[:6]]


_MAKERS: dict[str, Callable[[Path], list[Sample]]] = {
    "npy": _npy,
    "tiff": _tiff,
    "hdf5": _hdf5,
    "cine": _cine,
    "mraw": _mraw,
    "video": _video,
    "images": _images,
    "forces_text": _forces_text,
    "forces_hdf5": _forces_hdf5,
    "forces_matlab": _forces_matlab,
    "forces_tdms": _forces_tdms,
    "calibration": _calibration,
    "scene": _scene,
    "bundle": _bundle,
    "stream": _bundle,
    "result": _result,
    "streamed": _stream,
    "played": _played,
}
READERS = tuple(_MAKERS)
