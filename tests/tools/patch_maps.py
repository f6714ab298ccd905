#!/usr/bin/env python3
"""Puts a scan's surface together from its exported maps, and compares it with the mesh of the same level.

  patch_maps.py MESH.ply MAP.map.json [MAP.map.json...]

Knows only tools/export/PATCH_MAPS.md: reads the description, the atlas (TIFF without compression, or EXR) and the base
mesh by itself, evaluates the surface at all vertices, and looks for the nearest vertex of the mesh, and back. One map
must be of heights. States the largest differences. Exit codes: 0 all within their bounds, 1 usage, 7 beyond one.
"""
import json
import os
import struct
import sys
import zlib

import numpy as np


def read_tiff(path):
    data = open(path, "rb").read()
    end = {b"II": "<", b"MM": ">"}[data[:2]]
    assert struct.unpack(end + "H", data[2:4])[0] == 42, "a classic TIFF"
    (at,) = struct.unpack(end + "I", data[4:8])
    (count,) = struct.unpack(end + "H", data[at : at + 2])
    tags = {}
    for i in range(count):
        tag, kind, n = struct.unpack(end + "HHI", data[at + 2 + 12 * i : at + 10 + 12 * i])
        code = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 11: "f"}.get(kind)
        if code is None or code == "s":
            continue
        size = struct.calcsize(end + code) * n
        place = at + 10 + 12 * i
        if size > 4:
            (place,) = struct.unpack(end + "I", data[place : place + 4])
        tags[tag] = struct.unpack(end + code * n, data[place : place + size])
    assert tags.get(259, (1,))[0] == 1, "no compression"
    width, height, channels = tags[256][0], tags[257][0], tags.get(277, (1,))[0]
    bits, sample_format = tags[258][0], tags.get(339, (1,))[0]
    kind = {(8, 1): "u1", (16, 1): "u2", (32, 3): "f4"}[(bits, sample_format)]
    pixels = b"".join(data[o : o + n] for o, n in zip(tags[273], tags[279]))
    return np.frombuffer(pixels, end + kind).reshape(height, width, channels), kind


def read_exr(path):
    data = open(path, "rb").read()
    assert data[:4] == b"\x76\x2f\x31\x01"
    at = 8
    header = {}
    while data[at]:
        name_end = data.index(b"\0", at)
        kind_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack("<I", data[kind_end + 1 : kind_end + 5])
        header[data[at:name_end].decode()] = data[kind_end + 5 : kind_end + 5 + size]
        at = kind_end + 5 + size
    at += 1
    channels = []
    text = header["channels"]
    while text[0]:
        end = text.index(b"\0")
        channels.append((text[:end].decode(), struct.unpack("<I", text[end + 1 : end + 5])[0]))
        text = text[end + 17 :]
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    compression = header["compression"][0]
    lines = {0: 1, 2: 1, 3: 16}[compression]
    assert all(kind == 2 for _, kind in channels), "32-bit floats"
    out = np.zeros((height, width, len(channels)), "f4")
    blocks = (height + lines - 1) // lines
    for offset in struct.unpack("<%dQ" % blocks, data[at : at + 8 * blocks]):
        y, size = struct.unpack("<iI", data[offset : offset + 8])
        rows = min(lines, bottom - y + 1)
        raw = data[offset + 8 : offset + 8 + size]
        full = rows * width * 4 * len(channels)
        if compression and size < full:
            packed = np.frombuffer(zlib.decompress(raw), "u1").astype(np.int64)
            packed[1:] -= 128
            packed = (np.cumsum(packed) & 255).astype("u1")
            half = (full + 1) // 2
            plain = np.zeros(full, "u1")
            plain[0::2], plain[1::2] = packed[:half], packed[half:]
            raw = plain.tobytes()
        block = np.frombuffer(raw, "<f4").reshape(rows, len(channels), width)
        out[y - top : y - top + rows] = block.transpose(0, 2, 1)
    order = [n for n, _ in channels]
    if set(order) == {"R", "G", "B"}:
        out = out[:, :, [order.index(c) for c in "RGB"]]
    return out, "f4"


def read_ply(path):
    data = open(path, "rb").read()
    end = data.index(b"end_header\n") + len("end_header\n")
    header = data[:end].decode()
    origin = np.zeros(3)
    fields, vertices, in_vertices = [], 0, False
    for line in header.splitlines():
        words = line.split()
        if words[:2] == ["comment", "origin"]:
            origin = np.array([float(w.strip("(),:")) for w in words[2:5]])
        elif words[:1] == ["element"]:
            in_vertices = words[1] == "vertex"
            vertices = int(words[2]) if in_vertices else vertices
        elif words[:1] == ["property"] and in_vertices:
            fields.append((words[2], {"float": "<f4", "uchar": "u1"}[words[1]]))
    rows = np.frombuffer(data[end:], np.dtype(fields), vertices)
    stack = lambda names: np.stack([rows[n] for n in names], 1).astype(float)
    return stack("xyz") + origin, stack(["nx", "ny", "nz"]), stack(["red", "green", "blue"])


def across(inside, corners, u, v):
    """corners: patches x 4 x 3, at (0,0), (1,0), (0,1), (1,1); u over columns, v over rows."""
    c = corners[:, None, None, :, :]
    u, v = u[None, None, :, None], v[None, :, None, None]
    if inside == "triangles":
        right = c[..., 0, :] + u * (c[..., 1, :] - c[..., 0, :]) + v * (c[..., 3, :] - c[..., 1, :])
        left = c[..., 0, :] + v * (c[..., 2, :] - c[..., 0, :]) + u * (c[..., 3, :] - c[..., 2, :])
        return np.where(u >= v, right, left)
    assert inside == "bilinear"
    return (c[..., 0, :] * (1 - u) + c[..., 1, :] * u) * (1 - v) + (c[..., 2, :] * (1 - u) + c[..., 3, :] * u) * v


class Map:
    def __init__(self, path):
        self.json = json.load(open(path))
        assert self.json["format"] == "relievo patch map" and self.json["version"] == 1
        self.folder = os.path.dirname(path)
        image = os.path.join(self.folder, self.json["image"])
        pixels, kind = (read_exr if image.endswith(".exr") else read_tiff)(image)
        value, atlas = self.json["value"], self.json["atlas"]
        assert value["type"] == {"u1": "uint8", "u2": "uint16", "f4": "float32"}[kind], value
        assert pixels.shape[:2] == (atlas["height"], atlas["width"]), (pixels.shape, atlas)
        values = pixels.astype(float) * value["scale"] + value["offset"]
        self.step = value["scale"] if kind != "f4" else 0.0
        tile, columns = atlas["tile"], atlas["columns"]
        self.cells = self.json["cells"]
        assert tile == self.cells + 1
        self.tiles = np.stack(
            [
                values[p // columns * tile :][:tile, p % columns * tile :][:, :tile]
                for p in range(len(self.json["patches"]))
            ]
        )

    def corners(self, key):
        return np.array(self.json[key], float)[np.array(self.json["patches"])]

    def surface(self, heights):
        t = np.arange(self.cells + 1) / self.cells
        return (
            np.array(self.json["origin"])
            + across(self.json["inside"], self.corners("positions"), t, t)
            + heights * across(self.json["inside"], self.corners("directions"), t, t)
        )


def nearest(points, others):
    """For each point the index of the nearest of the others, and how far it is."""
    index = np.zeros(len(points), int)
    centre = others.mean(0)
    points, others = points - centre, others - centre
    squares = (others**2).sum(1)
    for first in range(0, len(points), 256):
        part = points[first : first + 256]
        index[first : first + 256] = np.argmin(squares[None] - 2 * part @ others.T, 1)
    return index, np.sqrt(((points - others[index]) ** 2).sum(1))


def check_base(m):
    """The .obj's corners lie at the description's corners, their texture coordinates at their tiles' corner texels."""
    v, vt, faces = [], [], []
    for line in open(os.path.join(m.folder, m.json["base"])):
        words = line.split()
        if words[:1] == ["v"]:
            v.append([float(w) for w in words[1:]])
        elif words[:1] == ["vt"]:
            vt.append([float(w) for w in words[1:]])
        elif words[:1] == ["f"]:
            faces.append([[int(n) - 1 for n in w.split("/")] for w in words[1:]])
    v, vt, atlas = np.array(v), np.array(vt), m.json["atlas"]
    worst_texel = worst_mm = 0.0
    assert len(faces) == len(m.json["patches"])
    for p, face in enumerate(faces):
        ring = [0, 2, 3, 1]
        for k, (corner, uv, _) in enumerate(face):
            i, j = (ring[k] & 1) * m.cells, (ring[k] >> 1) * m.cells
            x = p % atlas["columns"] * atlas["tile"] + i + 0.5
            y = p // atlas["columns"] * atlas["tile"] + j + 0.5
            found = vt[uv] * [atlas["width"], atlas["height"]]
            worst_texel = max(worst_texel, abs(found[0] - x), abs(atlas["height"] - found[1] - y))
            at = np.array(m.json["origin"]) + m.corners("positions")[p][ring[k]]
            worst_mm = max(worst_mm, np.abs(v[corner] - at).max())
    return worst_texel, worst_mm


def main():
    if len(sys.argv) < 3:
        print(__doc__, file=sys.stderr)
        return 1
    positions, normals, colours = read_ply(sys.argv[1])
    maps = [Map(path) for path in sys.argv[2:]]
    heights = next(m for m in maps if m.json["map"] == "height")
    surface = heights.surface(heights.tiles).reshape(-1, 3)
    extent = np.ptp(positions, axis=0).max()
    good = True

    def state(what, worst, bound, unit):
        nonlocal good
        good = good and worst <= bound
        print("%-34s %.3g %s (bound %.3g)%s" % (what, worst, unit, bound, "" if worst <= bound else "  BEYOND"))

    of_mesh, far = nearest(surface, positions)
    _, back = nearest(positions, surface)
    # A step of the map's numbers, and what a float keeps of a coordinate.
    bound = 0.5 * heights.step + 2.0**-22 * max(extent, np.abs(positions - heights.json["origin"]).max())
    state("surface to mesh, vertices", far.max(), bound, "mm")
    state("mesh to surface, vertices", back.max(), bound, "mm")
    # The comparison must be able to see a surface that lies otherwise.
    shifted = heights.surface(heights.tiles + 4 * bound).reshape(-1, 3)
    control = nearest(shifted[:2000], positions)[1].max()
    print("control: heights moved by %.3g mm are seen as %.3g mm" % (4 * bound, control))
    good = good and control > bound
    for m in maps:
        texel, mm = check_base(m)
        state(m.json["map"] + ": base quads' texels", texel, 1e-3, "px")
        state(m.json["map"] + ": base quads' corners", mm, 1e-9 * extent + 1e-9, "mm")
        assert m.cells == heights.cells, "maps of one level"
        values = m.tiles.reshape(-1, m.tiles.shape[-1])
        if m.json["map"] == "normal":
            lengths = np.sqrt((values**2).sum(1))
            state("normal: length less 1", np.abs(lengths - 1).max(), 2 * m.step + 1e-6, "")
            state("normal: less the mesh's", np.abs(values - normals[of_mesh]).max(), m.step / 2 + 1e-5, "")
        if m.json["map"] == "albedo":
            if m.json["value"]["colour_space"] == "linear light":
                values = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
            # Where patches meet the mesh has one of their colours.
            off = np.abs(255 * values - colours[of_mesh]).reshape(len(m.json["patches"]), m.cells + 1, -1, 3)
            state("albedo: less the mesh's, inside", off[:, 1:-1, 1:-1].max(initial=0), 0.01, "of 255")
    return 0 if good else 7


if __name__ == "__main__":
    sys.exit(main())
