"""Damage to archives: their members, their names, what they inflate to, their bytes."""

from __future__ import annotations

import gzip
import io
import tarfile
import warnings
import zipfile
import zlib
from random import Random
from typing import Final

from fuzz.mutators import raw, text, tiff, xml

_NAMES: Final = (
    "../escaped.tif", "/tmp/escaped.tif", "..\\escaped.tif", "a/../../b.tif", "", ".", "x" * 300,
    "a\nb.tif", "é.tif",
    "\udce9.tif", "CON", "a//b.tif", "%s%n.tif", "=1+1.tif",
)  # fmt: skip
_MEGABYTES: Final = (16, 300, 2048)
_MEGABYTE: Final = 1 << 20

Members = list[tuple[str, bytes]]


def read(data: bytes) -> tuple[str, Members]:
    """Return the kind of an archive, and its members."""
    if data[:2] == b"PK":
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            return "zip", [(each.filename, file.read(each)) for each in file.infolist()]
    kind = "tar.gz" if data[:2] == b"\x1f\x8b" else "tar"
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        files = [(each.name, archive.extractfile(each)) for each in archive if each.isfile()]
        return kind, [(name, file.read()) for name, file in files if file is not None]


def pack(kind: str, members: Members, odd: tarfile.TarInfo | None = None) -> bytes:
    """Return an archive of members, the same bytes each time."""
    made = io.BytesIO()
    if kind == "zip":
        with warnings.catch_warnings(), zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as file:
            warnings.simplefilter("ignore")  # of names that come twice: they are meant
            for name, content in members:
                file.writestr(zipfile.ZipInfo(_text(name) or "_"), content)
        return made.getvalue()
    with tarfile.open(fileobj=made, mode="w", format=tarfile.GNU_FORMAT, errors="surrogateescape") as archive:
        for name, content in members:
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
        if odd is not None:
            archive.addfile(odd)
    return gzip.compress(made.getvalue(), 1, mtime=0) if kind == "tar.gz" else made.getvalue()


def _text(name: str) -> str:
    return name.encode("utf-8", "replace").decode()


def member(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage a member."""
    kind, members = read(data)
    index = random.randrange(len(members))
    name, content = members[index]
    damage_of = tiff.damage if name.endswith("TIF") else xml.damage if name.endswith("xml") else text.damage
    made, did = (raw.damage if name.endswith("jp2") else damage_of)(random, content)
    members[index] = name, made
    return pack(kind, members), f"{name}: {did}"


def metadata(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage the description of the product."""
    kind, members = read(data)
    found = [index for index, (name, _) in enumerate(members) if "MTL" in name or "MTD" in name]
    if not found:
        return member(random, data)
    name, content = members[found[0]]
    made, did = (xml if name.endswith("xml") else text).damage(random, content)
    members[found[0]] = name, made
    return pack(kind, members), f"{name}: {did}"


def names(random: Random, data: bytes) -> tuple[bytes, str]:
    """Give a member another name, another's name, or put it away."""
    kind, members = read(data)
    index = random.randrange(len(members))
    old, content = members[index]
    if random.random() < 0.2:
        del members[index]
        return pack(kind, members), f"{old} is gone"
    new = random.choice((*_NAMES, random.choice(members)[0], old.lower(), f"folder/{old}"))
    members[index] = new, content
    if random.random() < 0.3:
        members.append((old, content))
    return pack(kind, members), f"{old} is {new[:40]!r}"


def odd_member(random: Random, data: bytes) -> tuple[bytes, str]:
    """Make a member of a tar a link, a device or a hole; of a zip, a folder or a repetition."""
    kind, members = read(data)
    name = random.choice(members)[0]
    if kind == "zip":
        return pack(kind, [*members, (f"{name}/", b""), *members]), f"{name} is a folder too, all twice"
    info = tarfile.TarInfo(name)
    info.type = random.choice(
        (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE, tarfile.DIRTYPE)
    )
    info.linkname = random.choice(("/etc/passwd", "../../ref.tif", name, "absent"))
    left = [each for each in members if each[0] != name]
    return pack(kind, left, info), f"{name} is of type {info.type.decode()}, to {info.linkname}"


def bomb(random: Random, data: bytes) -> tuple[bytes, str]:
    """Let a member inflate to much more than it takes."""
    kind, members = read(data)
    index, megabytes = random.randrange(len(members)), random.choice(_MEGABYTES)
    name, content = members[index]
    if kind == "tar":
        return raw.damage(random, data)
    if kind == "zip":
        return _zip_bomb(members, index, megabytes), f"{name} inflates to {megabytes} MB"
    head = tarfile.TarInfo(name)
    head.size = len(content) + megabytes * _MEGABYTE
    whole = pack("tar", [each for each in members if each[0] != name])[:-1024] + head.tobuf()
    first = zlib.compressobj(1, zlib.DEFLATED, 31)
    start = first.compress(whole + content) + first.flush(zlib.Z_FULL_FLUSH)
    return start + _zeros(megabytes), f"{name} inflates to {megabytes} MB"


def _zeros(megabytes: int) -> bytes:
    """Return raw deflate of so many megabytes of zeros, ended."""
    engine = zlib.compressobj(9, zlib.DEFLATED, -15)
    one = engine.compress(bytes(_MEGABYTE)) + engine.flush(zlib.Z_FULL_FLUSH)
    return one * megabytes + zlib.compressobj(9, zlib.DEFLATED, -15).flush()


def _zip_bomb(members: Members, index: int, megabytes: int) -> bytes:
    name, content = members[index]
    engine = zlib.compressobj(1, zlib.DEFLATED, -15)
    body = engine.compress(content) + engine.flush(zlib.Z_FULL_FLUSH) + _zeros(megabytes)
    # written as stored, then declared as deflated, so that nothing has to be inflated here
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for number, (each, inside) in enumerate(members):
            info = zipfile.ZipInfo(each)
            file.writestr(info, body if number == index else inside)
    done = bytearray(out.getvalue())
    size = (len(content) + megabytes * _MEGABYTE).to_bytes(4, "little")
    for signature, method_at, size_at, name_at in ((b"PK\3\4", 8, 22, 30), (b"PK\1\2", 10, 24, 46)):
        at = done.find(signature)
        while at >= 0 and done[at + name_at : at + name_at + len(name)] != name.encode():
            at = done.find(signature, at + 1)
        if at >= 0:
            done[at + method_at : at + method_at + 2] = b"\x08\0"
            done[at + size_at : at + size_at + 4] = size
    return bytes(done)


ALL = (member, member, metadata, metadata, names, odd_member, bomb, raw.damage, raw.damage)


def damage(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage an archive in one of these ways; of what cannot be read, the bytes."""
    try:
        return random.choice(ALL)(random, data)
    except (
        zipfile.BadZipFile,
        tarfile.TarError,
        IndexError,  # nothing is left in it
        OSError,
        ValueError,
        EOFError,
        zlib.error,
        NotImplementedError,
    ):
        return raw.damage(random, data)
