#!/usr/bin/env python3
"""Makes two sets of time steps with a solver of its own: something like a hurricane, and a fluid with two vortex rings.

    tests/scripts/simulate.py [hurricane] [fluid] [--steps N] [--small]

target/simulations/hurricane.nc     NetCDF, dates and kilometres: air speed, vorticity, temperature, humidity, updraft
target/simulations/fluid/fluid.pvd  ParaView's collection of VTI files: vorticity, speed, pressure

Both are incompressible flow with buoyancy in a rotating box (Boussinesq), pseudo-spectral in space with the 2/3 rule, in time by
Adams and Bashforth with exact viscosity. Each takes about a minute on one processor; --small halves the grid. numpy and netCDF4 come
from PyPI into a virtual environment of its own at the first run.
"""
import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
VENV = ROOT / "target" / "simulations-venv"
FOLDER = ROOT / "target" / "simulations"


def enter_environment():
    python = VENV / "bin/python"
    if Path(sys.prefix) == VENV:
        return
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "numpy", "netCDF4"], check=True)
    os.execv(python, [python, *sys.argv])


class Flow:
    """Velocity, buoyancy and humidity in a periodic box; arrays are z, y, x, vectors x, y, z."""

    def __init__(self, shape, lengths, viscosity, rotation=0.0, drag=None, heating=0.0):
        self.viscosity, self.rotation, self.drag, self.heating = viscosity, rotation, drag, heating
        frequencies = [2 * np.pi * np.fft.fftfreq(n, 1 / n) / length for n, length in zip(shape, lengths)]
        frequencies[2] = 2 * np.pi * np.fft.rfftfreq(shape[2], 1 / shape[2]) / lengths[2]
        kz, ky, kx = np.meshgrid(*frequencies, indexing="ij")
        self.k = np.stack([kx, ky, kz])
        self.k2 = (self.k**2).sum(axis=0)
        self.inverse_k2 = 1 / np.where(self.k2 == 0, 1, self.k2)
        limits = [2 / 3 * np.abs(f).max() for f in frequencies]
        self.kept = (np.abs(kz) < limits[0]) & (np.abs(ky) < limits[1]) & (np.abs(kx) < limits[2])
        self.axes = [np.linspace(0, length, n, endpoint=False) for n, length in zip(shape, lengths)]
        self.shape = shape
        self.state = self.before = None

    def forward(self, field):
        return np.fft.rfftn(field, axes=(-3, -2, -1))

    def back(self, spectrum):
        return np.fft.irfftn(spectrum, s=self.shape, axes=(-3, -2, -1))

    def begin(self, velocity, buoyancy, humidity):
        fields = np.concatenate([velocity, buoyancy[None], humidity[None]])
        self.state = self.forward(fields) * self.kept
        self.state[:3] = self.without_divergence(self.state[:3])

    def without_divergence(self, vector):
        return vector - self.k * ((self.k * vector).sum(axis=0) * self.inverse_k2)

    def curl(self, vector):
        kx, ky, kz = self.k
        u, v, w = vector
        return 1j * np.stack([ky * w - kz * v, kz * u - kx * w, kx * v - ky * u])

    def rates(self):
        velocity, scalars = self.back(self.state[:3]), self.back(self.state[3:])
        vorticity = self.back(self.curl(self.state[:3]))
        vorticity[2] += self.rotation
        force = np.cross(velocity, vorticity, axis=0)
        force[2] += scalars[0]
        if self.drag is not None:
            force -= self.drag * velocity
        slopes = self.back(1j * self.k[None] * self.state[3:, None])
        change = -(velocity[None] * slopes).sum(axis=1)
        # Rising moist air is warmed and loses its humidity.
        rain = self.heating * np.maximum(velocity[2], 0) * np.maximum(scalars[1], 0)
        change[0] += rain
        change[1] -= 0.3 * rain
        rates = self.forward(np.concatenate([force, change])) * self.kept
        rates[:3] = self.without_divergence(rates[:3])
        return rates

    def advance(self, seconds, max_step):
        """At most so long steps, and none that goes over more than half a cell."""
        speed = np.abs(self.back(self.state[:3])).max()
        cell = min(axis[1] for axis in self.axes)
        count = max(1, int(np.ceil(seconds / min(max_step, 0.5 * cell / max(speed, 1e-9)))))
        length = seconds / count
        decay = np.exp(-self.viscosity * self.k2 * length)
        for _ in range(count):
            rates = self.rates()
            before = rates if self.before is None else self.before
            self.state = (self.state + length * (1.5 * rates - 0.5 * before)) * decay
            self.before = rates * decay

    def pressure(self):
        velocity = self.back(self.state[:3])
        force = self.forward(np.cross(velocity, self.back(self.curl(self.state[:3])), axis=0))
        head = -1j * (self.k * force).sum(axis=0) * self.inverse_k2
        return self.back(head) - 0.5 * (velocity**2).sum(axis=0)


def length_of(vector):
    return np.sqrt((vector**2).sum(axis=0))


def hurricane(steps, small):
    """A warm vortex in a rotating box, with friction at its foot and moist air that is warmed as it rises."""
    n = 64 if small else 128
    shape, lengths = (n // 4, n, n), (0.5, 2.0, 2.0)
    z, y, x = (np.linspace(0, length, m, endpoint=False) for m, length in zip(shape, lengths))
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    foot = np.exp(-((z / 0.05) ** 2))
    top = np.exp(-(((z - 0.5) / 0.06) ** 2))
    flow = Flow(shape, lengths, 6e-5, rotation=1.0, drag=3.0 * foot + 4.0 * top, heating=2.5)
    px, py = x - 1.0, y - 1.0
    r, angle = np.hypot(px, py), np.arctan2(py, px)
    # A ring of vorticity breaks up into bands; further out there is little wind.
    ripple = 1 + 0.06 * np.cos(3 * angle) + 0.05 * np.cos(5 * angle + 1)
    swirl = 1.9 * r / 0.16 * np.exp(0.5 * (1 - (r / (0.16 * ripple)) ** 2)) + 0.35 * np.exp(-((r - 0.45) ** 2) / 0.03)
    swirl *= np.cos(np.pi * z / 1.0) ** 2
    r = np.maximum(r, 1e-6)
    velocity = np.stack([-py / r * swirl, px / r * swirl, 0 * r])
    noise = np.random.default_rng(1).normal(size=shape)
    warm = 0.5 * np.exp(-((r / 0.22) ** 2)) * np.sin(np.pi * z / 0.5) ** 2
    bands = 0.5 + 0.5 * np.cos(2 * angle - 14 * r)
    humid = np.exp(-z / 0.12) * (0.5 + 0.5 * bands * np.exp(-((r / 0.7) ** 2))) * (1 + 0.02 * noise)
    flow.begin(velocity, warm, humid * (1 - top))

    path = FOLDER / "hurricane.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.title = "Something like a hurricane"
        file.createDimension("time", None)
        time = file.createVariable("time", "f8", ("time",))
        time.units, time.calendar = "hours since 2026-09-01 00:00:00", "standard"
        for name, axis, scale in zip("zyx", flow.axes, (100.0,) * 3):
            file.createDimension(name, len(axis))
            file.createVariable(name, "f4", (name,))[:] = axis * scale
            file[name].units = "km"
        units = {"air_speed": "m s-1", "vorticity": "1e-4 s-1", "temperature": "K", "humidity": "g kg-1", "updraft": "m s-1"}
        for name, unit in units.items():
            file.createVariable(name, "f4", ("time", "z", "y", "x"), zlib=True, complevel=1)
            file[name].units = unit
        for step in range(steps):
            velocity = flow.back(flow.state[:3])
            buoyancy, humidity = flow.back(flow.state[3:])
            time[step] = 3 * step
            file["air_speed"][step] = 32 * length_of(velocity)
            file["vorticity"][step] = 2 * length_of(flow.back(flow.curl(flow.state[:3])))
            file["temperature"][step] = 12 * buoyancy
            file["humidity"][step] = 20 * np.maximum(humidity, 0)
            file["updraft"][step] = 32 * velocity[2]
            flow.advance(0.08, 0.01)
            print(f"\rhurricane: {step + 1} of {steps}", end="", file=sys.stderr, flush=True)
    print(f"\r{path}            ")


def ring(x, y, z, centre, radius, core, tilt):
    """Vorticity of a ring that moves along x, turned about z."""
    c, s = np.cos(tilt), np.sin(tilt)
    dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
    along, across = c * dx + s * dy, -s * dx + c * dy
    out = np.maximum(np.hypot(across, dz), 1e-9)
    strength = np.exp(-((out - radius) ** 2 + along**2) / core**2)
    turn_y, turn_z = -dz / out * strength, across / out * strength
    return np.stack([-s * turn_y, c * turn_y, turn_z])


def fluid(steps, small):
    """Two vortex rings that meet at an angle, and reconnect."""
    n = 48 if small else 72
    size = 2 * np.pi
    shape, lengths = (n, n, n), (size, size, size)
    z, y, x = np.meshgrid(*[np.linspace(0, size, n, endpoint=False)] * 3, indexing="ij")
    flow = Flow(shape, lengths, 1e-2)
    middle = size / 2
    vorticity = 12 * (
        ring(x, y, z, (middle - 1.1, middle - 0.75, middle), 0.85, 0.35, 0.75)
        + ring(x, y, z, (middle - 1.1, middle + 0.75, middle), 0.85, 0.35, -0.75)
    )
    vorticity *= 1 + 0.05 * np.cos(4 * np.arctan2(z - middle, y - middle))
    spectrum = flow.forward(vorticity)
    velocity = flow.back(flow.curl(spectrum) * flow.inverse_k2)
    flow.begin(velocity, 0 * x, 0 * x)

    folder = FOLDER / "fluid"
    folder.mkdir(exist_ok=True)
    rows = []
    for step in range(steps):
        name, time = f"fluid_{step:03}.vti", 0.1 * step
        fields = {
            "vorticity": length_of(flow.back(flow.curl(flow.state[:3]))),
            "speed": length_of(flow.back(flow.state[:3])),
            "pressure": flow.pressure(),
        }
        write_vti(folder / name, fields, size / n)
        rows.append(f'    <DataSet timestep="{time:.3f}" group="" part="0" file="{name}"/>')
        flow.advance(0.1, 0.025)
        print(f"\rfluid: {step + 1} of {steps}", end="", file=sys.stderr, flush=True)
    text = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>\n'
    path = folder / "fluid.pvd"
    path.write_text(text + "\n".join(rows) + "\n  </Collection>\n</VTKFile>\n")
    print(f"\r{path}            ")


def write_vti(path, fields, spacing):
    """Samples as they are, behind the markup."""
    nz, ny, nx = next(iter(fields.values())).shape
    extent = f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}"
    arrays, blocks, offset = [], [], 0
    for name, samples in fields.items():
        block = samples.astype("<f4").tobytes()
        arrays.append(f'<DataArray type="Float32" Name="{name}" format="appended" offset="{offset}"/>')
        blocks.append(np.uint64(len(block)).tobytes() + block)
        offset += len(blocks[-1])
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{spacing} {spacing} {spacing}"><Piece Extent="{extent}">'
        f'<PointData Scalars="{next(iter(fields))}">\n' + "\n".join(arrays) + '\n</PointData></Piece></ImageData>\n'
        '<AppendedData encoding="raw">\n_'
    )
    path.write_bytes(head.encode() + b"".join(blocks) + b"\n</AppendedData></VTKFile>\n")


def read_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET", help="hurricane or fluid; by default both")
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--small", action="store_true")
    arguments = parser.parse_args()
    for name in arguments.sets:
        if name not in MAKERS:
            parser.error(f"{name!r}, expected hurricane or fluid")
    return arguments


def main(arguments):
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in arguments.sets or MAKERS:
        MAKERS[name](arguments.steps, arguments.small)


MAKERS = {"hurricane": hurricane, "fluid": fluid}
# Before packages are installed: --help needs none.
arguments = read_arguments()
enter_environment()
import netCDF4  # noqa: E402
import numpy as np  # noqa: E402

main(arguments)
