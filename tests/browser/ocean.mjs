/** The temperature of the ocean as a volume that isopeel reads: from the classic NetCDF file of a climatology that Ferret wrote. */

import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";

/** Bytes of a value, by the numbers of types. */
const SIZES = { 1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8 };
const FLOAT = 5;
/** Steps of the grid: two degrees; the levels, of which the upper ones lie close together, are drawn at equal distances. */
const SPACING = [2, 2, 5];

/** Where in the file the first month of a variable lies, and its size along each axis, the fastest first. */
function locate(bytes, wanted) {
  let at = 8;
  const u32 = () => bytes.readUInt32BE((at += 4) - 4);
  const skip = (length) => (at += Math.ceil(length / 4) * 4);
  const name = () => {
    const length = u32();
    const text = bytes.toString("latin1", at, at + length);
    skip(length);
    return text;
  };
  const list = (read) => {
    u32();
    return Array.from({ length: u32() }, read);
  };
  const attributes = () =>
    list(() => {
      name();
      skip(SIZES[u32()] * u32());
    });
  const dims = list(() => ({ name: name(), size: u32() }));
  attributes();
  const variables = list(() => {
    const found = { name: name(), sizes: Array.from({ length: u32() }, () => dims[u32()].size) };
    attributes();
    return { ...found, type: u32(), bytes: u32(), offset: u32() };
  });
  const found = variables.find((variable) => variable.name === wanted);
  if (found?.type !== FLOAT || found.sizes.length !== 4) throw new Error(`${wanted} is ${JSON.stringify(found)}, expected floats along four axes`);
  return { offset: found.offset, sizes: found.sizes.slice(1).reverse() };
}

/** Writes January as `ocean-temperature.nrrd` into a folder, north up and the surface on top, and returns the file. */
export function writeOcean(source, folder) {
  const bytes = readFileSync(source);
  if (bytes.toString("latin1", 0, 4) !== "CDF\x01") throw new Error(`${source} is no classic NetCDF file`);
  const { offset, sizes } = locate(bytes, "TEMP");
  const [nx, ny, nz] = sizes;
  const header = ["NRRD0004", "type: float", "dimension: 3", `sizes: ${sizes.join(" ")}`, `spacings: ${SPACING.join(" ")}`, "endian: little", "encoding: raw", 'sample units: "°C"', "", ""].join("\n");
  const samples = Buffer.alloc(4 * nx * ny * nz);
  for (let z = 0; z < nz; z += 1)
    for (let i = 0; i < nx * ny; i += 1) {
      const value = bytes.readFloatBE(offset + 4 * (z * nx * ny + i));
      // On land there is no temperature.
      samples.writeFloatLE(value < -1e30 ? NaN : value, 4 * ((nz - 1 - z) * nx * ny + i));
    }
  const file = join(folder, "ocean-temperature.nrrd");
  writeFileSync(file, Buffer.concat([Buffer.from(header), samples]));
  return file;
}
