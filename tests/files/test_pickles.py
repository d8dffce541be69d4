"""Pickles of model files: what they contain is read as plain arrays, whatever wrote them; everything else is refused by name."""

from __future__ import annotations

import collections
import io
import os
import pickle
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from python2_pickles import chumpy, python2_pickle, selected, write_object_array, write_python2

from avatarrex.errors import InputError
from avatarrex.files import pickles
from avatarrex.files.arrays import read_array, read_arrays
from avatarrex.files.pickles import read_pickle

RNG = np.random.default_rng(0)
GIVEN = {
    "f": RNG.integers(0, 700, (50, 3)).astype(np.uint32),
    "v": RNG.normal(size=(40, 3)),
    "turned": np.asfortranarray(RNG.normal(size=(6, 5)).astype(np.float32)),
    "big": RNG.normal(size=7).astype(">f8"),
    "flag": np.array([True, False]),
    "none": np.zeros((0, 3)),
    "names": np.array(["a", "bc"]),
}


def same(found: object, wanted: np.ndarray) -> None:
    assert isinstance(found, np.ndarray)
    assert found.dtype.kind == wanted.dtype.kind
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    path = tmp_path / "m.pkl"
    path.write_bytes(
        pickle.dumps({**GIVEN, "list": [1, -2.5, 2**70, None, True, (1,), (1, 2, 3, 4)], "n": np.float32(3)}, protocol)
    )
    found = read_pickle(path, "a model")
    for key, value in GIVEN.items():
        same(found[key], value)
    assert found["list"] == [1, -2.5, 2**70, None, True, (1,), (1, 2, 3, 4)]
    assert found["n"] == 3


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_python_2_with_chumpy_and_a_sparse_matrix(tmp_path: Path, protocol: int) -> None:
    """As MANO's files are: arrays in Latin-1 texts with every byte, chumpy's objects for arrays, a regressor by columns."""
    regressor = scipy.sparse.csc_matrix(np.round(RNG.random((16, 30)) ** 8, 2))
    every = np.arange(256, dtype=np.uint8)
    given = {
        "shapedirs": selected(GIVEN["v"]), "posedirs": chumpy(GIVEN["turned"]), "J_regressor": regressor, "every": every,
        "bs_style": "lbs", "quoted": "it's\n\\ \xff",
    }  # fmt: skip
    found = read_pickle(write_python2(tmp_path / "m.pkl", given, protocol), "a model")
    same(found["shapedirs"], GIVEN["v"])
    same(found["posedirs"], GIVEN["turned"])
    same(found["every"], every)
    np.testing.assert_array_equal(found["J_regressor"].toarray(), regressor.toarray())
    assert (found["bs_style"], found["quoted"]) == ("lbs", "it's\n\\ \xff")


def test_names_of_python_2_are_what_such_files_have() -> None:
    """The writer of these tests: what it writes has the globals of the time, and no others."""
    content = python2_pickle(
        {"a": chumpy(GIVEN["v"]), "s": selected(GIVEN["v"]), "j": scipy.sparse.csc_matrix(np.eye(2))}
    )
    for name in (
        b"numpy.core.multiarray\n_reconstruct",
        b"chumpy.ch\nCh",
        b"chumpy.reordering\nSelect",
        b"scipy.sparse.csc\ncsc_matrix",
    ):
        assert b"c" + name + b"\n" in content
    assert b"numpy._core" not in content
    assert b"_codecs" not in content


def test_csr_ordered_dict_and_an_npy_of_a_dict(tmp_path: Path) -> None:
    matrix = scipy.sparse.csr_matrix(np.eye(3)[[0, 2]])
    given = collections.OrderedDict(meanshape=GIVEN["v"], j=matrix, names=["a", "b"])
    found = read_pickle(write_object_array(tmp_path / "face.npy", given), "a face")
    same(found["meanshape"], GIVEN["v"])
    np.testing.assert_array_equal(found["j"].toarray(), matrix.toarray())
    assert found["names"] == ["a", "b"]
    assert read_pickle((tmp_path / "face.npy").read_bytes(), "a face")["names"] == ["a", "b"]
    with pytest.raises(InputError, match=r"^zip/face\.npy: expected a face that is whole"):
        read_pickle((tmp_path / "face.npy").read_bytes()[:-9], "a face", place="zip/face.npy")


class Evil:
    """Something that would run a command."""

    def __init__(self, *call: object) -> None:
        self.call = call

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return self.call[0], self.call[1:]


@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize(
    ("call", "name"),
    [((os.system, "touch evil"), "posix.system"), ((eval, "1"), "eval"), ((np.fromfile, "x"), "fromfile"),
     ((np.load, "x"), "load"), ((getattr, 1, "real"), "getattr"), ((bytearray, 10**12), "bytearray")],
)  # fmt: skip
def test_another_global_is_refused_by_name(tmp_path, monkeypatch, protocol, call, name) -> None:
    monkeypatch.chdir(tmp_path)
    Path("m.pkl").write_bytes(pickle.dumps({"f": GIVEN["f"], "x": Evil(*call)}, protocol))
    with pytest.raises(InputError) as caught:
        read_pickle("m.pkl", "a model")
    said = str(caught.value)
    assert said.startswith("m.pkl: byte ")
    assert (
        "expected numbers, texts, lists, dicts, NumPy arrays, SciPy csc and csr matrices, chumpy Ch and Select, found"
        in said
    )
    assert name in said
    assert "\n" not in said
    assert not Path("evil").exists()


def stored(content: bytes) -> bytes:
    return b"\x80\x02" + content + b"."


def array_of(shape: bytes, data: bytes, kind: bytes = b"f8") -> bytes:
    """An array's opcodes; `shape` and `data` as opcodes of their own."""
    made = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
    typed = (
        b"cnumpy\ndtype\nU"
        + bytes([len(kind)])
        + kind
        + b"K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    )
    return made + b"(K\x01" + shape + typed + b"\x89" + data + b"tb"


BAD: dict[str, tuple[bytes, str]] = {
    "an instance of os.system": (stored(b"(S'x'\nios\nsystem\n"), "found the global os.system"),
    "a global by names on the stack": (b"\x80\x04\x8c\x02os\x8c\x06system\x93.", "found the global os.system"),
    "a persistent id": (stored(b"Pdisk\n"), "found the opcode PERSID"),
    "an extension": (stored(b"\x82\x01"), "found the opcode EXT1"),
    "nothing": (b"", "a model that is whole"),
    "no pickle": (b"hello", "a model that is whole"),
    "a cut one": (python2_pickle(GIVEN)[:-40], "a model that is whole"),
    "a text of 2^62 bytes": (stored(b"\x8d" + struct.pack("<Q", 2**62)), "a model that is whole"),
    "bytes of 2^62": (stored(b"\x8e" + struct.pack("<Q", 2**62)), "a model that is whole"),
    "a memo of 2^31": (stored(b"Nr" + struct.pack("<I", 2**31)), ""),
    "a long of 2^31 bytes": (stored(b"\x8b" + struct.pack("<i", 2**31 - 1)), "a model that is whole"),
    "a million numbers in eight bytes": (stored(array_of(b"J\x40\x42\x0f\x00\x85", b"U\x08" + bytes(8))), "8 bytes for shape"),
    "a shape below zero": (stored(array_of(b"J\xff\xff\xff\xff\x85", b"U\x00")), "a shape of other numbers than sides"),
    "an array of objects": (stored(array_of(b"K\x01\x85", b"U\x08" + bytes(8), b"O8")), "an array of objects"),
    "an array of a strange type": (stored(array_of(b"K\x01\x85", b"U\x08" + bytes(8), b"M8")), "the NumPy type M8"),
    "a bytes object of a size": (stored(b"c__builtin__\nbytes\nJ\x00\x00\x00\x7f\x85R"), "with arguments"),
    "a list in itself": (stored(b"]q\x00h\x00a"), "lists nested too deeply"),
    "900 lists": (stored(b"]" * 900 + b"a" * 899), "lists nested too deeply"),
    "a list as a key": (stored(b"}]Ns"), "a model that is whole"),
    "a class by itself": (stored(b"cnumpy\nndarray\n"), "the global numpy.ndarray by itself"),
    "a chumpy object without an array": (stored(b"cchumpy.ch\nCh\n)\x81}U\x01xNsb"), "Ch.x that is no array"),
    "a stray mark": (stored(b"t"), "a model that is whole"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_damaged_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    """And takes no memory: it has none of what it claims."""
    content, said = BAD[name]
    (tmp_path / "m.pkl").write_bytes(content)
    tracemalloc.start()
    if said:
        with pytest.raises(InputError) as caught:
            read_pickle(tmp_path / "m.pkl", "a model")
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
    else:
        read_pickle(tmp_path / "m.pkl", "a model")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6


def twice(depth: int) -> bytes:
    """(t, t) of t, `depth` times over: 2^depth of the innermost, in a few bytes each."""
    return b")" + b"q\x63h\x63\x86" * depth


def made(kind: bytes, **state: bytes) -> bytes:
    """An object of chumpy's, built of opcodes by attribute."""
    fields = b"".join(b"U" + bytes([len(name)]) + name.encode() + value for name, value in state.items())
    return b"c" + kind + b"\n)\x81}(" + fields + b"ub"


CH, SELECT = b"chumpy.ch\nCh", b"chumpy.reordering\nSelect"
ZERO = array_of(b"K\x01\x85", b"U\x01\x00", b"i1")
GIANT = b"\x8b" + struct.pack("<i", 2**16) + b"\x7f" * 2**16
"""An integer of half a million bits."""
LONG_LIST = b"](" + b"U\x01aK\x00\x86q\x62" + b"h\x62" * 2**12 + b"eq\x61"
MANY_ZEROS = array_of(b"J\x00\x00\x01\x00\x85", b"T" + struct.pack("<I", 2**16) + bytes(2**16), b"i1")
LONG_TEXT = array_of(b"K\x01\x85", b"T" + struct.pack("<I", 9999) + bytes(9999), b"S9999")
BOMBS: dict[str, tuple[bytes, str]] = {
    "sets of a long list": (LONG_LIST + b"0](" + b"c__builtin__\nset\nh\x61\x85R" * 1500 + b"e", ""),
    "ordered dicts of a long list": (LONG_LIST + b"0](" + b"ccollections\nOrderedDict\nh\x61\x85R" * 40 + b"e", "arrays of at most"),
    "one long text, selected often": (made(SELECT, a=LONG_TEXT, idxs=MANY_ZEROS), "arrays of at most"),
    "selected by no integers": (made(SELECT, a=ZERO, idxs=array_of(b"K\x01\x85", b"U\x08" + bytes(8))), "no integers"),
    "selected of the selected": (ZERO + (b"q\x00" + made(SELECT, a=b"h\x00", idxs=b"h\x00")) * 30, ""),
    "a type of tuples": (b"cnumpy\ndtype\n" + twice(40) + b"\x85R", "no short text"),
    "a type of a long text": (b"cnumpy\ndtype\nU\xff" + b"f" * 255 + b"\x85R", "no short text"),
    "a key of tuples": (b"}" + twice(40) + b"Ns", "a key that is a tuple"),
    "keys of tuples": (b"}(" + twice(40) + b"Nu", "a key that is a tuple"),
    "a dict of tuples": (b"(" + twice(40) + b"Nd", "a key that is a tuple"),
    "an ordered dict of tuples": (b"ccollections\nOrderedDict\n](" + twice(40) + b"N\x86e\x85R", "a key that is a tuple"),
    "a giant key": (b"}" + GIANT + b"Ns", "a key that is a int"),
    "a global of tuples": (twice(40) + b"U\x01x\x93", "a global whose name is no text"),
    "an encoding of tuples": (b"c_codecs\nencode\nU\x01x" + twice(40) + b"\x86R", "no Latin-1 text"),
    "a shape of giants": (array_of(b"(" + GIANT + b"q\x60" + b"h\x60" * 1000 + b"t", b"U\x00"), "an array without shape"),
    "a giant side": (array_of(GIANT + b"\x85", b"U\x00"), "other numbers than sides"),
    "a list of a giant shape": (array_of(GIANT + b"\x85", b"]", b"O8"), "other numbers than sides"),
    "a chumpy object of itself": (b"cchumpy.ch\nCh\n)\x81q\x00}U\x01xh\x00sb", "a Ch without its attributes"),
    "chumpy objects of one another": (b"cchumpy.ch\nCh\n)\x81}U\x01x" * 1200 + ZERO + b"sb" * 1200, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_takes_little_memory_and_time(name: str) -> None:
    """Each of a few kB; copies, tuples of tuples and selections of selections would fill the memory, or never end."""
    content, said = BOMBS[name]
    tracemalloc.start()
    if said:
        with pytest.raises(InputError) as caught:
            read_pickle(stored(content), "a model", 2**22)
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
    else:
        read_pickle(stored(content), "a model", 2**22)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6


@pytest.mark.parametrize(
    "header",
    [b"{'descr': '''", b"{" * 5000, b"{'descr': '<f8', 'fortran_order': False, 'shape': (0x1" + b"0" * 5000 + b",)}"],
)
def test_a_broken_header_is_refused_in_one_line(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    for read in (lambda path: read_pickle(path, "a model"), read_array):
        with pytest.raises(InputError) as caught:
            read(tmp_path / "a.npy")
        assert "\n" not in str(caught.value)


def test_letters_that_unicode_does_not_have_are_refused(tmp_path: Path) -> None:
    """Python itself fails on such a text, wherever it is looked at first; either byte order."""
    for kind in ("<U3", ">U3"):
        texts = np.array(["abc", "d"], dtype=kind)
        np.save(tmp_path / "a.npy", texts)
        assert read_array(tmp_path / "a.npy").tolist() == ["abc", "d"]
        content = (tmp_path / "a.npy").read_bytes()
        (tmp_path / "a.npy").write_bytes(content[:-12] + b"\x7f" * 12)
        np.savez(tmp_path / "a.npz", a=texts)
        with pytest.raises(InputError, match="a letter that Unicode does not have"):
            read_array(tmp_path / "a.npy")
        pickled = pickle.dumps(texts, 4)
        assert read_pickle(pickled, "a model").tolist() == ["abc", "d"]
        with pytest.raises(InputError, match="a letter that Unicode does not have"):
            read_pickle(pickled.replace(texts.tobytes(), b"\x7f" * 24), "a model")
        np.savez(tmp_path / "a.npz", a=texts)
        stored = (tmp_path / "a.npz").read_bytes()
        (tmp_path / "a.npz").write_bytes(rezipped(stored, texts.tobytes(), b"\x7f" * 24))
        with pytest.raises(InputError, match="a letter that Unicode does not have"):
            read_arrays(tmp_path / "a.npz")


def rezipped(content: bytes, old: bytes, new: bytes) -> bytes:
    """A zip with bytes of its members replaced, and their checksums made anew."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(stream, "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name).replace(old, new))
    return stream.getvalue()


def test_lengths_are_whole_numbers(tmp_path: Path) -> None:
    """NumPy takes True for a length in a header, and then fails."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (True,), }\n"
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(8))
    with pytest.raises(InputError, match="a shape of other numbers than sides"):
        read_array(tmp_path / "a.npy")


def test_bytes_that_many_arrays_share_are_counted_each() -> None:
    """A text of 4 MB that 100 arrays are made of would be 400 MB."""
    block = b"T" + struct.pack("<I", 2**22) + bytes(2**22)
    content = block + b"q\x010]"
    content += b"".join(array_of(b"J" + struct.pack("<i", 2**19) + b"\x85", b"h\x01") + b"a" for _ in range(100))
    with pytest.raises(InputError, match="arrays of at most"):
        read_pickle(stored(content), "a model", 2**26)


@pytest.mark.parametrize(
    "change", [{"indices": np.array([9])}, {"indptr": np.array([0, 5])}, {"indptr": np.array([0])}]
)
def test_a_sparse_matrix_is_checked(tmp_path: Path, change: dict[str, np.ndarray]) -> None:
    matrix = scipy.sparse.csc_matrix(np.array([[1.0], [0.0]]))
    for name, value in change.items():
        setattr(matrix, name, value.astype(np.int32))
    with pytest.raises(InputError, match="a model that is whole"):
        read_pickle(write_python2(tmp_path / "m.pkl", matrix), "a model")


@pytest.mark.parametrize("rows", [2**40, True])
def test_a_sparse_matrix_has_sides_that_an_array_can_have(tmp_path: Path, rows: int) -> None:
    """Its few numbers fit the file; made dense it would be terabytes."""
    matrix = scipy.sparse.csc_matrix(np.array([[1.0]]))
    matrix._shape = (rows, 1)
    with pytest.raises(InputError, match="a model that is whole, found a shape of other numbers than sides"):
        read_pickle(write_python2(tmp_path / "m.pkl", matrix), "a model")


def test_endless_opcodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """None and its removal, again and again: nothing is made, and time goes by, a microsecond each."""
    assert pickles.MOST_STEPS <= 2_000_000
    monkeypatch.setattr(pickles, "MOST_STEPS", 1000)
    assert read_pickle(stored(b"N0" * 400 + b"N"), "a model") is None
    with pytest.raises(InputError, match="a pickle of at most 1,000 opcodes"):
        read_pickle(stored(b"N0" * 500 + b"N"), "a model")


def test_changed_files_raise_nothing_else(tmp_path: Path) -> None:
    """A file with some bytes changed is read or refused; nothing runs, nothing else is raised."""
    rng = np.random.default_rng(3)
    given = {
        "a": chumpy(GIVEN["v"]),
        "s": selected(GIVEN["v"]),
        "j": scipy.sparse.csc_matrix(np.eye(4)),
        "names": ["x", ("y", 2)],
    }
    contents = [python2_pickle(given, protocol) for protocol in (0, 1, 2)] + [pickle.dumps(GIVEN, p) for p in (2, 4, 5)]
    refused = 0
    for _ in range(250):
        content = bytearray(contents[rng.integers(len(contents))])
        for place in rng.integers(0, len(content), rng.integers(1, 6)):
            content[place] = rng.integers(256)
        (tmp_path / "m.pkl").write_bytes(content[: rng.integers(1, len(content))] if rng.random() < 0.2 else content)
        said = refusal(tmp_path / "m.pkl")
        refused += bool(said)
        assert "\n" not in said
    assert refused > 80


def refusal(path: Path) -> str:
    """Why a file is refused; empty where it is read."""
    try:
        read_pickle(path, "a model")
    except InputError as error:
        return str(error)
    return ""
