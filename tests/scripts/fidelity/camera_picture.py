"""The picture of a cut for a camera: beside the cut that is alike everywhere, with as many triangles, and beneath each its error in pixels.

Each triangle is shaded as the plane it is, with its edges. The error of a pixel is the larger of two distances: from the point that
is seen there of the shown surface to the full one, and from that of the full one to the shown one.
"""
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from fidelity.camera import root_mean_square
from fidelity.pictures import CAPTION, FAINT, GAP, INK, MARGIN, PAPER, bar, colour_of

# Pixels at the dark end of the bar.
WORST = 4.0
SAMPLING = 2
BAR = 96
# Strengths and directions of lights: to the right, up and away from the camera.
LIGHTS = [(0.72, (-0.5, 0.6, -0.7)), (0.22, (0.7, 0.1, -0.5))]
AMBIENT = 0.22
SURFACE, EDGE = np.array([245, 232, 206]), np.array([52, 54, 58])
EDGE_PIXELS, EDGE_OPACITY = 1.0, 0.6


@dataclass(frozen=True)
class Panel:
    title: str
    triangles: int
    rms: float
    beyond: float  # share of the picture that is off by more than a pixel
    shaded: Image.Image
    error: Image.Image


def shade(camera, mesh):
    """The mesh in flat shading, with the edges of its triangles."""
    large = camera.enlarged(SAMPLING)
    _, triangle = large.buffers(mesh)
    row, column = np.nonzero(triangle >= 0)
    corners = large.in_eye(mesh.points)[mesh.faces[triangle[row, column]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal[(normal * large.rays(row, column)).sum(1) > 0] *= -1
    strength = AMBIENT
    for share, direction in LIGHTS:
        strength = strength + share * np.maximum(normal @ (np.array(direction) / np.linalg.norm(direction)), 0)
    colour = np.minimum(strength[:, None] * SURFACE, 255)
    width = SAMPLING * EDGE_PIXELS / 2
    opacity = EDGE_OPACITY * np.clip(width + 0.5 - to_edges(large, corners, row, column), 0, 1)[:, None]
    pixels = np.full((*triangle.shape, 3), PAPER, np.uint8)
    pixels[row, column] = colour * (1 - opacity) + EDGE * opacity
    return Image.fromarray(pixels).resize(camera.size, Image.LANCZOS)


def to_edges(camera, corners, row, column):
    """Distance in the picture from the middle of a pixel to the nearest side of the triangle that it shows."""
    width, height = camera.size
    place = corners[..., :2] / corners[..., 2:] * camera.focal * [1, -1] + [width / 2, height / 2]
    pixel = np.stack([column + 0.5, row + 0.5], 1)
    nearest = np.full(len(row), np.inf)
    for a, b in [(0, 1), (1, 2), (2, 0)]:
        side, offset = place[:, b] - place[:, a], pixel - place[:, a]
        across = np.abs(side[:, 0] * offset[:, 1] - side[:, 1] * offset[:, 0])
        nearest = np.minimum(nearest, across / np.maximum(np.linalg.norm(side, axis=1), 1e-9))
    return nearest


def panel(title, camera, full, mesh):
    """A mesh as the camera sees it, and how far it is from the full one."""
    truth, seen = camera.see(full), camera.see(mesh)
    there, back = camera.pixels(truth, mesh), camera.pixels(seen, full)
    error = np.full(camera.size[::-1], -1.0)
    error[truth.row, truth.column] = there
    error[seen.row, seen.column] = np.maximum(error[seen.row, seen.column], back)
    shown = error >= 0
    pixels = np.full((*error.shape, 3), PAPER, np.uint8)
    pixels[shown] = colour_of(error[shown] / WORST)
    beyond = float(np.mean(error[shown] > 1))
    return Panel(title, len(mesh.faces), root_mean_square(there, back), beyond, shade(camera, mesh), Image.fromarray(pixels))


def draw(panels, base, path):
    """Writes the sheet: a column for each panel, `base` below them."""
    side = panels[0].shaded.size
    width = 2 * MARGIN + len(panels) * side[0] + (len(panels) - 1) * GAP
    sheet = Image.new("RGB", (width, CAPTION + 2 * side[1] + GAP + BAR), PAPER)
    pen = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(27), ImageFont.load_default(20)
    for place, one in enumerate(panels):
        left = MARGIN + place * (side[0] + GAP)
        pen.text((left, 14), one.title, font=large, fill=INK)
        said = f"{one.triangles:,} triangles, rms {one.rms:.2f} pixels, {one.beyond:.1%} off by more than a pixel"
        pen.text((left, 46), said, font=small, fill=FAINT)
        sheet.paste(one.shaded, (left, CAPTION))
        sheet.paste(one.error, (left, CAPTION + side[1] + GAP))
    pen.text((MARGIN, sheet.height - 54), base, font=small, fill=INK, anchor="lm")
    bar(pen, width - MARGIN - 40, sheet.height - 62, small, WORST, "distance to the full surface, in pixels")
    sheet.save(path, quality=50, method=6)
