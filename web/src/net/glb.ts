/** Several GLB files of the server as one: a node each, with a material of its own. Loaded when it is asked for. Pure. */

/** One surface. */
export interface GlbPart {
  readonly name: string;
  /** Red, green and blue, linear, 0 to 1, in place of the vertices' colours; without one these stay. */
  readonly color: readonly [number, number, number] | undefined;
  readonly opacity: number;
  readonly file: ArrayBuffer;
}

/** The part of the server's glTF 2.0 that is read here. */
interface Document {
  readonly asset: { readonly generator?: string; readonly extras?: unknown };
  /** One, which turns the volume's positions into glTF's. */
  readonly nodes?: readonly { readonly rotation?: readonly number[]; readonly scale?: readonly number[] }[];
  readonly meshes?: readonly { readonly primitives: readonly Primitive[] }[];
  readonly materials?: readonly Record<string, unknown>[];
  readonly accessors?: readonly (Record<string, unknown> & { readonly bufferView: number })[];
  readonly bufferViews?: readonly View[];
}

interface Primitive {
  readonly attributes: Readonly<Record<string, number>>;
  readonly indices: number;
  readonly [more: string]: unknown;
}

interface View {
  readonly byteOffset?: number;
  readonly byteLength: number;
  readonly target?: number;
}

const MAGIC = 0x46546c67;
const VERSION = 2;
const JSON_CHUNK = 0x4e4f534a;
const BINARY_CHUNK = 0x004e4942;
const HEADER_BYTES = 12;
const CHUNK_HEADER_BYTES = 8;

/** @throws when one of the files is none, or all of them are more than the 4 GiB of a GLB */
export function joinGlb(parts: readonly GlbPart[]): Blob {
  const joined = new Joined();
  for (const part of parts) joined.add(part);
  return joined.file();
}

class Joined {
  private generator = "isopeel";
  private readonly nodes: object[] = [];
  private readonly meshes: object[] = [];
  private readonly materials: object[] = [];
  private readonly accessors: object[] = [];
  private readonly views: object[] = [];
  private readonly pieces: Uint8Array<ArrayBuffer>[] = [];
  private bytes = 0;

  /** A file without a surface adds nothing. */
  add({ name, color, opacity, file }: GlbPart): void {
    const { document, binary } = readGlb(name, file);
    const { asset, nodes = [], meshes = [], materials = [] } = document;
    const { rotation, scale } = nodes[0] ?? {};
    this.generator = asset.generator ?? this.generator;
    const copy = this.copier(document, binary);
    for (const { primitives } of meshes) {
      const material = this.materials.push(materialOf(materials[0] ?? {}, name, color, opacity)) - 1;
      const mesh = this.meshes.push({ name, primitives: primitives.map((primitive) => ({ ...copied(primitive, copy, color !== undefined), material })) }) - 1;
      this.nodes.push({ name, mesh, rotation, scale, extras: asset.extras });
    }
  }

  file(): Blob {
    const text = new TextEncoder().encode(JSON.stringify(this.document()));
    const padded = new Uint8Array(4 * Math.ceil(text.length / 4)).fill(0x20);
    padded.set(text);
    const total = HEADER_BYTES + CHUNK_HEADER_BYTES + padded.length + (this.bytes > 0 ? CHUNK_HEADER_BYTES + this.bytes : 0);
    if (total > 0xffffffff) throw new Error(`the surfaces have ${total} bytes, expected at most the 4 GiB of a GLB`);
    const binary = this.bytes > 0 ? [words(this.bytes, BINARY_CHUNK), ...this.pieces] : [];
    return new Blob([words(MAGIC, VERSION, total), words(padded.length, JSON_CHUNK), padded, ...binary], { type: "model/gltf-binary" });
  }

  private document(): object {
    const { nodes, meshes, materials, accessors, views, bytes, generator } = this;
    const asset = { version: "2.0", generator };
    if (nodes.length === 0) return { asset, scene: 0, scenes: [{ name: "no isosurface" }] };
    const scenes = [{ nodes: nodes.map((_, node) => node) }];
    return { asset, scene: 0, scenes, nodes, meshes, materials, accessors, bufferViews: views, buffers: [{ byteLength: bytes }] };
  }

  /** Copies an accessor of a file and the views it refers to, each once; returns its new number. */
  private copier({ accessors = [], bufferViews = [] }: Document, binary: Uint8Array<ArrayBuffer>): (accessor: number) => number {
    const view = once((number: number) => {
      const { byteOffset = 0, byteLength, target } = bufferViews[number] ?? { byteLength: 0 };
      this.pieces.push(binary.subarray(byteOffset, byteOffset + byteLength), new Uint8Array(-byteLength & 3));
      const made = this.views.push({ buffer: 0, byteOffset: this.bytes, byteLength, target }) - 1;
      this.bytes += 4 * Math.ceil(byteLength / 4);
      return made;
    });
    return once((number: number) => {
      const accessor = accessors[number];
      if (accessor === undefined) throw new Error(`a GLB without the accessor ${number} that it uses`);
      return this.accessors.push({ ...accessor, bufferView: view(accessor.bufferView) }) - 1;
    });
  }
}

function once(make: (number: number) => number): (number: number) => number {
  const made = new Map<number, number>();
  return (number) => {
    const known = made.get(number) ?? make(number);
    made.set(number, known);
    return known;
  };
}

function copied({ attributes, indices, ...more }: Primitive, copy: (accessor: number) => number, isOneColor: boolean): object {
  const kept = Object.entries(attributes).filter(([name]) => !(isOneColor && name.startsWith("COLOR_")));
  return { ...more, attributes: Object.fromEntries(kept.map(([name, accessor]) => [name, copy(accessor)])), indices: copy(indices) };
}

function materialOf(of: Record<string, unknown>, name: string, color: GlbPart["color"], opacity: number): object {
  const pbr = { ...(of.pbrMetallicRoughness as object | undefined), baseColorFactor: [...(color ?? [1, 1, 1]), opacity] };
  return { ...of, name, pbrMetallicRoughness: pbr, ...(opacity < 1 ? { alphaMode: "BLEND" } : {}) };
}

function readGlb(name: string, file: ArrayBuffer): { readonly document: Document; readonly binary: Uint8Array<ArrayBuffer> } {
  const view = new DataView(file);
  const u32 = (offset: number) => (offset + 4 <= file.byteLength ? view.getUint32(offset, true) : 0);
  if (u32(0) !== MAGIC || u32(4) !== VERSION || u32(8) !== file.byteLength || u32(16) !== JSON_CHUNK) {
    throw new Error(`${name}: ${file.byteLength} bytes that are no whole GLB of version ${VERSION}`);
  }
  const start = HEADER_BYTES + CHUNK_HEADER_BYTES;
  const text = new Uint8Array(file, start, u32(12));
  const next = start + text.length;
  const hasBinary = u32(next + 4) === BINARY_CHUNK;
  const binary = hasBinary ? new Uint8Array(file, next + CHUNK_HEADER_BYTES, u32(next)) : new Uint8Array(0);
  return { document: JSON.parse(new TextDecoder().decode(text)) as Document, binary };
}

/** 32 bits each, low bytes first. */
function words(...numbers: readonly number[]): Uint8Array<ArrayBuffer> {
  const bytes = new Uint8Array(4 * numbers.length);
  const view = new DataView(bytes.buffer);
  numbers.forEach((n, i) => view.setUint32(4 * i, n, true));
  return bytes;
}
