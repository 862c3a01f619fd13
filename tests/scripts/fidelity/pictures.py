"""The picture of the page: one part of a skull by four methods with as many triangles, and beneath it how far they are off.

Drawn by VTK without a window; each triangle is shaded as the plane it is. Errors are distances of the mesh from the trilinear
isosurface, at the corners of triangles divided until none is longer than half a voxel: a coarse triangle is right at its corners.
"""
import numpy as np
import trimesh
import vtk
from PIL import Image, ImageDraw, ImageFont
from vtk.util import numpy_support as vn

SHARE = 0.08
PANEL = (560, 600)
SAMPLING = 2
GAP, MARGIN, CAPTION, BAR = 12, 36, 74, 96
PAPER, INK, FAINT = (244, 243, 240), (38, 38, 40), (112, 110, 108)
IVORY = (0.96, 0.91, 0.81)
# Of the part: orbit, cheekbone, nose and teeth, in world units.
FOCUS, EYE, HALF_HEIGHT = np.array([104.0, 190.0, 44.0]), np.array([-0.38, 1.0, 0.1]), 45.0
# Voxels at the dark end of the bar.
WORST = 1.0
# From none to the worst: magma of matplotlib (CC0), perceptually uniform, light first.
MAGMA = [
    "fcfdbf", "fddea0", "febf84", "fe9f6d", "fa7d5e", "f1605d", "de4968", "c43c75", "a8327d",
    "8c2981", "721f81", "57157e", "3b0f70", "221150", "100b2d", "030212",
]
COLOURS = np.array([[int(code[at : at + 2], 16) for at in (0, 2, 4)] for code in MAGMA[:14]], float)


def colour_of(share):
    """Colour of an error, 0 to 1 of the worst."""
    at = np.clip(share, 0, 1) * (len(COLOURS) - 1)
    low = np.minimum(at.astype(int), len(COLOURS) - 2)
    weight = (at - low)[..., None]
    return COLOURS[low] * (1 - weight) + COLOURS[low + 1] * weight


def in_view(points, faces):
    """The triangles near the part that is drawn."""
    reach = HALF_HEIGHT * 1.6
    return faces[(np.abs(points[faces] - FOCUS).max(2) < reach).any(1)]


def actor(points, faces, colours=None):
    data = vtk.vtkPolyData()
    corners = vtk.vtkPoints()
    corners.SetData(vn.numpy_to_vtk(np.ascontiguousarray(points, np.float32), deep=True))
    data.SetPoints(corners)
    cells = vtk.vtkCellArray()
    connectivity = vn.numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, np.int64).ravel(), deep=True)
    cells.SetData(3, connectivity)
    data.SetPolys(cells)
    mapper = vtk.vtkPolyDataMapper()
    if colours is not None:
        data.GetPointData().SetScalars(vn.numpy_to_vtk(np.ascontiguousarray(colours, np.uint8), deep=True))
        mapper.SetColorModeToDirectScalars()
    mapper.SetInputData(data)
    result = vtk.vtkActor()
    result.SetMapper(mapper)
    surface = result.GetProperty()
    surface.SetInterpolationToFlat()
    surface.SetColor(*IVORY)
    surface.SetAmbient(0.26 if colours is None else 0.75)
    surface.SetDiffuse(1.0 if colours is None else 0.35)
    return result


def light(direction, strength):
    """A distant light that moves with the camera."""
    result = vtk.vtkLight()
    result.SetLightTypeToCameraLight()
    result.SetPosition(*direction)
    result.SetFocalPoint(0, 0, 0)
    result.SetIntensity(strength)
    return result


def render(shown):
    """A panel, with shade where light hardly reaches."""
    renderer = vtk.vtkRenderer()
    renderer.SetBackground(*(value / 255 for value in PAPER))
    renderer.AddActor(shown)
    renderer.AutomaticLightCreationOff()
    for direction, strength in [((-0.8, 1.0, 0.9), 0.8), ((1.0, 0.1, 0.7), 0.3), ((0, -0.8, 0.5), 0.12)]:
        renderer.AddLight(light(direction, strength))
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    camera.SetParallelScale(HALF_HEIGHT)
    camera.SetFocalPoint(*FOCUS)
    camera.SetPosition(*(FOCUS + EYE / np.linalg.norm(EYE) * 300))
    camera.SetViewUp(0, 0, 1)
    renderer.ResetCameraClippingRange()
    occlusion = vtk.vtkSSAOPass()
    occlusion.SetRadius(10)
    occlusion.SetKernelSize(128)
    occlusion.SetBias(0.8)
    occlusion.BlurOn()
    occlusion.SetDelegatePass(vtk.vtkRenderStepsPass())
    renderer.SetPass(occlusion)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(*(SAMPLING * side for side in PANEL))
    window.AddRenderer(renderer)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    pixels = vn.vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
    image = Image.fromarray(pixels.reshape(SAMPLING * PANEL[1], SAMPLING * PANEL[0], -1)[::-1, :, :3].copy())
    return image.resize(PANEL, Image.LANCZOS)


def panels(mesh, truth):
    """The surface, and the same by its error."""
    loaded = trimesh.load(mesh, process=False, force="mesh")
    points, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces)
    faces = in_view(points, faces)
    plain = render(actor(points, faces))
    fine, parts = trimesh.remesh.subdivide_to_size(points, faces, 0.5 * min(truth.spacing), max_iter=12)
    distance, _ = truth.nearest(fine / truth.spacing)
    return plain, render(actor(fine, parts, colour_of(distance / WORST)))


def bar(pen, right, top, font, worst, text):
    """The shared colour bar, with its ends to the right."""
    width, height = 520, 16
    left = right - width
    for x in range(width):
        pen.line([(left + x, top), (left + x, top + height)], fill=tuple(int(v) for v in colour_of(np.array(x / width))))
    for share in (0, 0.25, 0.5, 0.75, 1):
        x = left + width * share
        label = f"{share * worst:g}" if share < 1 else f"{worst:g} and more"
        pen.line([(x, top + height), (x, top + height + 5)], fill=FAINT)
        pen.text((x, top + height + 8), label, font=font, fill=INK, anchor="ma")
    pen.text((left - 16, top + height / 2), text, font=font, fill=INK, anchor="rm")


def draw(one, folder):
    """Writes fidelity-methods.webp."""
    count = one.wanted(SHARE)
    maker = one.maker
    columns = [
        ("the paper: marching cubes, cut by beta", maker.marching_cubes(count)),
        ("isopeel: octree, cut by error", maker.octree(count)),
        ("isopeel: vertex tree", maker.tree(count)),
        ("VTK and meshopt_simplify", maker.meshopt(count)),
    ]
    width = 2 * MARGIN + len(columns) * PANEL[0] + (len(columns) - 1) * GAP
    sheet = Image.new("RGB", (width, CAPTION + 2 * PANEL[1] + GAP + BAR), PAPER)
    pen = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(27), ImageFont.load_default(20)
    for place, (title, mesh) in enumerate(columns):
        left = MARGIN + place * (PANEL[0] + GAP)
        found, (lost, without) = one.truth.distances(mesh), one.truth.lost(mesh)
        pen.text((left, 14), title, font=large, fill=INK)
        said = f"{found['triangles']:,} triangles, rms {found['rms']:.2f}; {without:.2f} without the {lost:.1%} lost"
        pen.text((left, 46), said, font=small, fill=FAINT)
        for row, panel in enumerate(panels(mesh, one.truth)):
            sheet.paste(panel, (left, CAPTION + row * (PANEL[1] + GAP)))
    base = f"{one.source.title.replace('`', '')} HU, {SHARE:.0%} of {one.maker.full_triangles():,} triangles"
    pen.text((MARGIN, sheet.height - 54), base, font=small, fill=INK, anchor="lm")
    bar(pen, width - MARGIN - 40, sheet.height - 62, small, WORST, "distance to the trilinear isosurface, in voxels")
    sheet.save(folder / "fidelity-methods.webp", quality=84, method=6)
