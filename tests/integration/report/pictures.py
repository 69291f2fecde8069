"""Looks at screenshots with the standard library only."""

import struct
import zlib


def decode_png(data):
    """Width, height and rows of 8-bit RGB or RGBA pixels (PNG specification: filters 0 to 4, no interlace)."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    place, packed, header = 8, b"", None
    while place < len(data):
        (length,) = struct.unpack(">I", data[place : place + 4])
        kind, body = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed += body
        place += 12 + length
    width, height, depth, color, _, _, interlace = header
    assert depth == 8 and color in (2, 6) and interlace == 0
    step = 3 if color == 2 else 4
    raw, rows, previous = zlib.decompress(packed), [], bytes(width * step)
    for y in range(height):
        start = y * (width * step + 1)
        mode, line = raw[start], bytearray(raw[start + 1 : start + 1 + width * step])
        for i in range(len(line)):
            left = line[i - step] if i >= step else 0
            above, corner = previous[i], previous[i - step] if i >= step else 0
            if mode == 1:
                line[i] = (line[i] + left) & 255
            elif mode == 2:
                line[i] = (line[i] + above) & 255
            elif mode == 3:
                line[i] = (line[i] + (left + above) // 2) & 255
            elif mode == 4:
                estimate = left + above - corner
                a, b, c = abs(estimate - left), abs(estimate - above), abs(estimate - corner)
                line[i] = (line[i] + (left if a <= b and a <= c else above if b <= c else corner)) & 255
        rows.append([tuple(line[x : x + 3]) for x in range(0, len(line), step)])
        previous = bytes(line)
    return width, height, rows


def difference(first, second):
    """Share of pixels that differ visibly."""
    changed = total = 0
    for row_a, row_b in zip(first[2], second[2]):
        for a, b in zip(row_a, row_b):
            total += 1
            changed += max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2])) > 24
    return changed / total


def colors(picture):
    """Number of distinct colours, 4 bits a channel."""
    return len({(r >> 4, g >> 4, b >> 4) for row in picture[2] for r, g, b in row})
