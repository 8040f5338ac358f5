"""The checkpoint reader: tensors come out of any file of torch.save, and nothing of the file ever runs."""

import argparse
import builtins
import io
import os
import pickle
import pickletools
import zipfile
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from export.checkpoint.reader import Inert, read_tensors
from runtime.errors import CheckpointError

FORMATS = pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])


class Call:
    """Pickles as a call of `function` with `arguments`."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def training_state():
    """What training scripts write beside the weights."""
    network = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    optimizer = torch.optim.Adam(network.parameters())
    network(torch.ones(4, 3)).sum().backward()
    optimizer.step()
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.9)
    return network, {
        "state_dict": network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "optimizer object": optimizer,
        "scheduler": scheduler,
        "args": argparse.Namespace(lr=0.1, tensor=torch.ones(2)),
        "best": np.float64(0.5),
        "array": np.arange(3),
        "epoch": 7,
    }


@FORMATS
def test_tensors_come_out_from_among_training_objects(tmp_path, zipped):
    network, state = training_state()
    torch.save(state, tmp_path / "file", _use_new_zipfile_serialization=zipped)
    with pytest.raises(pickle.UnpicklingError):
        torch.load(tmp_path / "file", weights_only=True)
    content = read_tensors(tmp_path / "file")
    assert type(content["state_dict"]) is dict
    assert content["state_dict"].keys() == network.state_dict().keys()
    for key, value in network.state_dict().items():
        assert torch.equal(content["state_dict"][key], value)
        assert content["state_dict"][key].dtype == value.dtype
    moments = content["optimizer"]["state"][0]["exp_avg"]
    assert torch.equal(moments, state["optimizer"]["state"][0]["exp_avg"])
    assert content["epoch"] == 7
    for key in ("optimizer object", "scheduler", "args", "best", "array"):
        assert isinstance(content[key], Inert), key
    assert content["args"].name == "argparse.Namespace"


@FORMATS
def test_every_kind_of_tensor_is_as_it_was(tmp_path, zipped):
    base = torch.arange(24.0).reshape(4, 6)
    tensors = {
        "view": base[1:, ::2],
        "transposed": base.T,
        "scalar": torch.tensor(3),
        "empty": torch.empty(0, 3),
        "parameter": nn.Parameter(torch.ones(2, 2)),
        **{
            str(dtype): torch.ones(5).to(dtype)
            for dtype in (torch.float16, torch.bfloat16, torch.float64, torch.int32, torch.uint8, torch.bool)
        },
    }
    nested = OrderedDict(a=[base, (base, {"b": base})])
    file = tmp_path / "file"
    torch.save(
        {"refused": argparse.Namespace(), "nested": nested, **tensors},
        file,
        _use_new_zipfile_serialization=zipped,
    )
    content = read_tensors(file)
    for key, value in tensors.items():
        assert torch.equal(content[key], value), key
        assert content[key].dtype == value.dtype, key
        assert type(content[key]) is torch.Tensor, key
    assert torch.equal(content["nested"]["a"][1][1]["b"], base)


def test_a_container_that_holds_itself_is_read(tmp_path):
    content = {"refused": argparse.Namespace()}
    content["self"] = content
    torch.save(content, tmp_path / "file")
    read = read_tensors(tmp_path / "file")
    assert read["self"] is read


def hostile(marker: Path):
    """Objects that would make `marker` if anything of them ran."""
    code = f"open({str(marker)!r}, 'w')"
    touch = f"touch {marker}"
    return {
        "os.system": Call(os.system, touch),
        "eval": Call(builtins.eval, code),
        "exec": Call(builtins.exec, code),
        "open": Call(builtins.open, str(marker), "w"),
        "getattr": Call(getattr, Call(__import__, "os"), "system"),
        "torch.hub": Call(torch.hub.load, str(marker.parent), "model", "main", None, True),
        "torch.load": Call(torch.load, str(marker.parent / "inner")),
        "torch.save": Call(torch.save, {}, str(marker)),
        "load bytes": Call(torch.storage._load_from_bytes, pickle.dumps(Call(os.system, touch))),
    }


@FORMATS
@pytest.mark.parametrize("attack", list(hostile(Path("marker"))))
@pytest.mark.parametrize("place", ["value", "optimizer", "list"])
def test_calls_in_the_file_are_never_made(tmp_path, attack, place, zipped):
    marker = tmp_path / "marker"
    evil = hostile(marker)[attack]
    weights = {"weight": torch.ones(2)}
    content = {
        "value": {"state_dict": weights, "evil": evil},
        "optimizer": {"state_dict": weights, "optimizer": {"state": {0: {"step": evil}}}},
        "list": {"state_dict": weights, "hooks": [evil, (evil,)]},
    }[place]
    torch.save(content, tmp_path / "file", _use_new_zipfile_serialization=zipped)
    read = read_tensors(tmp_path / "file")
    assert torch.equal(read["state_dict"]["weight"], torch.ones(2))
    assert not marker.exists()


def archive(path: Path, data: bytes, storages=None, compression=zipfile.ZIP_STORED) -> Path:
    """A file in the layout of torch.save around any pickle."""
    with zipfile.ZipFile(path, "w", compression) as file:
        file.writestr("archive/data.pkl", data)
        file.writestr("archive/version", "3\n")
        for key, value in (storages or {}).items():
            file.writestr(f"archive/data/{key}", value)
    return path


def tensor_pickle(size=(2,), stride=(1,), offset=0, count=4, kind="torch FloatStorage", key="0", word="storage"):
    """The pickle of {"n": Namespace, "t": tensor}, any arguments of the rebuild; torch refuses it at "n"."""
    writer = io.BytesIO()
    writer.write(b"\x80\x02}(X\x01\x00\x00\x00ncargparse\nNamespace\n)\x81X\x01\x00\x00\x00t")
    writer.write(b"ctorch._utils\n_rebuild_tensor_v2\n((")
    writer.write(plain(word) + b"c" + kind.replace(" ", "\n").encode() + b"\n")
    writer.write(plain(key) + plain("cpu") + plain(count) + b"tQ")
    writer.write(plain(offset) + plain(size) + plain(stride) + b"\x89}tRu.")
    return writer.getvalue()


def plain(value) -> bytes:
    """The opcodes that push a plain value."""
    return pickletools.optimize(pickle.dumps(value, 2))[2:-1]


DATA = np.arange(4, dtype=np.float32).tobytes()


def test_the_handmade_tensor_is_read(tmp_path):
    content = read_tensors(archive(tmp_path / "file", tensor_pickle(offset=1), {"0": DATA}))
    assert content["t"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "odd",
    [
        {"size": (5,)},
        {"offset": 3},
        {"offset": -1},
        {"offset": 2**62},
        {"offset": "0"},
        {"size": (-1,)},
        {"size": (2, 2)},
        {"size": (2,), "stride": (-1,)},
        {"size": (3,), "stride": (2,)},
        {"size": (2**40,), "stride": (0,)},
        {"size": (2**33, 2**33), "stride": (0, 0)},
        {"size": "ab", "stride": "cd"},
        {"size": (1.0,)},
        {"size": 2},
        {"count": 5},
        {"count": 2**60, "size": (2**50,)},
        {"count": "4"},
        {"count": -4},
        {"kind": "os system"},
        {"kind": "torch load"},
        {"kind": "torch DoubleStorage"},
        {"kind": "torch QInt8Storage"},
        {"key": "1"},
        {"key": "../../secret"},
        {"key": 0},
        {"word": "module"},
    ],
    ids=str,
)
def test_odd_arguments_of_a_tensor_are_refused(tmp_path, odd):
    file = archive(tmp_path / "file", tensor_pickle(**odd), {"0": DATA})
    with pytest.raises(CheckpointError, match="is no checkpoint"):
        read_tensors(file)


@pytest.mark.parametrize(
    "data",
    [
        b"\x80\x04\x8c\x02os\x8c\x06system\x93(\x8c\x04TOUCHtR.",  # REDUCE at the top
        b"\x80\x04\x8c\x0btorch._utils\x8c\x09os.system\x93(\x8c\x04TOUCHtR.",  # dotted name
        b"(X\x05\x00\x00\x00TOUCHios\nsystem\n.",  # INST
        b"(cos\nsystem\nX\x05\x00\x00\x00TOUCHo.",  # OBJ
        b"\x80\x02cos\nsystem\nX\x05\x00\x00\x00TOUCH\x85\x81.",  # NEWOBJ
        b"\x80\x02cargparse\nNamespace\n}X\x04\x00\x00\x00nameX\x01\x00\x00\x00asb.",  # BUILD on a class
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n)R.",  # too few arguments
        b"\x80\x02ctorch._utils\n_rebuild_parameter\n)R.",
        b"\x80\x02X\x01\x00\x00\x00aX\x01\x00\x00\x00b\x85R.",  # a call of a string
        b"\x80\x02}X\x01\x00\x00\x00a\x93.",  # names that are no strings
        b"\x82\x01.",  # copyreg's extensions
        b"\x80\x02]r\xff\xff",  # cut short
        b"",
    ],
)
def test_hostile_pickles_are_no_checkpoint(tmp_path, data):
    marker = tmp_path / "marker"
    for path in (tmp_path / "zip", tmp_path / "bare"):
        if path.name == "zip":
            archive(path, data.replace(b"TOUCH", b"touch " + str(marker).encode()))
        else:
            path.write_bytes(data)
        with pytest.raises(CheckpointError):
            read_tensors(path)
    assert not marker.exists()


def test_no_name_of_the_file_is_imported(tmp_path):
    """A module that writes the marker when it is imported."""
    (tmp_path / "evil_module.py").write_text(f"open({str(tmp_path / 'marker')!r}, 'w')")
    data = b"\x80\x02}(X\x01\x00\x00\x00acevil_module\nthing\n)Ru."
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        content = read_tensors(archive(tmp_path / "file", data))
    assert isinstance(content["a"], Inert)
    assert not (tmp_path / "marker").exists()


def test_state_on_an_ordered_dict_changes_nothing(tmp_path):
    """BUILD may set attributes: they must not shadow methods or reach the mapping that comes out."""
    data = (
        b"\x80\x02}(X\x01\x00\x00\x00aceval\neval\nX\x01\x00\x00\x00bccollections\nOrderedDict\n)R"
        b"X\x01\x00\x00\x00kK\x01s}X\x05\x00\x00\x00itemsK\x02sbu."
    )
    content = read_tensors(archive(tmp_path / "file", data))
    assert content["b"] == {"k": 1}
    assert not hasattr(content["b"], "__dict__")


@FORMATS
def test_a_file_cut_short_is_no_checkpoint(tmp_path, zipped):
    _, state = training_state()
    file = tmp_path / "file"
    torch.save(state, file, _use_new_zipfile_serialization=zipped)
    whole = file.read_bytes()
    for part in (0.01, 0.5, 0.99):
        file.write_bytes(whole[: int(len(whole) * part)])
        with pytest.raises(CheckpointError, match=r"is no checkpoint.*fetch or copy it again"):
            read_tensors(file)


@pytest.mark.parametrize(
    "data", [b"", b"hello, I am a text file\n" * 50, b"\x00" * 500, b"<html><body>404</body></html>"]
)
def test_a_file_of_something_else_is_no_checkpoint(tmp_path, data):
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(CheckpointError, match=r"is no checkpoint.*pass a file that torch.save wrote"):
        read_tensors(tmp_path / "file")


def test_no_file_and_a_folder_are_no_checkpoint(tmp_path):
    with pytest.raises(CheckpointError, match=r"is no checkpoint.*no such file"):
        read_tensors(tmp_path / "none")
    with pytest.raises(CheckpointError, match=r"is no checkpoint.*a folder"):
        read_tensors(tmp_path)


def test_archives_of_something_else_are_no_checkpoint(tmp_path):
    np.savez(tmp_path / "file.npz", a=np.ones(3))
    compressed = archive(tmp_path / "compressed", tensor_pickle(), {"0": DATA}, compression=zipfile.ZIP_DEFLATED)
    for file in (tmp_path / "file.npz", compressed):
        with pytest.raises(CheckpointError, match="is no checkpoint"):
            read_tensors(file)


def test_a_whole_network_or_tensor_says_how_to_save_it(tmp_path):
    for value, what in ((nn.Linear(2, 2), "torch.nn.modules.linear.Linear"), (torch.ones(2), "Tensor")):
        torch.save(value, tmp_path / "file")
        with pytest.raises(CheckpointError, match=rf"holds a {what}.*network.state_dict"):
            read_tensors(tmp_path / "file")
