/** Materials of the surfaces: one program a look and pass, compiled when it is first used. Colours come from tables that the owner passes. */

import {
  BackSide,
  Color,
  DataTexture,
  DoubleSide,
  FloatType,
  FrontSide,
  GLSL3,
  Matrix3,
  RGBAFormat,
  ReplaceStencilOp,
  ShaderMaterial,
  Vector2,
  Vector3,
  Vector4,
  type IUniform,
  type Material,
  type Texture,
} from "three";
import { regionTexture, type ColoredRegion } from "./coloredRegions";
import { linearFromSrgb, lookUp } from "./colorTable";
import { DEFAULT_LOOK, DEFAULT_STYLE, SHADINGS, type Look, type SurfaceStyle } from "./look";
import { MASK_FRAGMENT, MAX_ISOLINES, NO_VALUE, NORMAL_FRAGMENT, PICK_FRAGMENT, surfaceFragment, VERTEX, WIRE_FRAGMENT, type ProgramVariant } from "./shaders";

/** A rendering pass of a surface. */
export type Pass =
  /** Its colour, opaque. */
  | "opaque"
  /** One layer of it, translucent. */
  | "peel"
  /** Its bit in the stencil buffer: set at pixels at which its nearest layer shows its inside, cleared at those that show its outside. */
  | "inside"
  | "outside"
  /** View position and surface number. */
  | "pick"
  /** Normal in view space, for ambient occlusion. */
  | "normal";

/** Uniforms that all surfaces share. */
export class SharedUniforms {
  readonly worldFromGrid: IUniform<Matrix3> = { value: new Matrix3() };
  /** From normals in the world to those that the camera's matrix turns into those of the world as it is shown. */
  readonly normalScale: IUniform<Vector3> = { value: new Vector3(1, 1, 1) };
  /** Clipping planes in view space; their negative side is cut away. */
  readonly clipPlanes: IUniform<Vector4[]> = { value: [] };
  /** Values of vertices that have the first and the last colour. */
  readonly valueRange: IUniform<Vector2> = { value: new Vector2(0, 1) };
  /** Depths between which a layer lies. */
  readonly nearer: IUniform<Texture | null> = { value: null };
  readonly opaque: IUniform<Texture | null> = { value: null };
  /** Half the width of isolines, pixels. */
  readonly isolineWidth: IUniform<number> = { value: 0.6 };
  readonly wireColor: IUniform<Color> = { value: new Color() };
}

function row(colors: Float32Array<ArrayBuffer>): DataTexture {
  const texture = new DataTexture(colors, colors.length / 4, 1, RGBAFormat, FloatType);
  texture.needsUpdate = true;
  return texture;
}

/** Lookup tables; colours in sRGB. */
export interface ColorTables {
  /** RGBA bytes over the blended feature: colour and importance. */
  readonly transfer: Uint8Array<ArrayBuffer>;
  /** RGBA bytes over importance. */
  readonly importance: Uint8Array<ArrayBuffer>;
  /** One colour a level, finest first. */
  readonly levels: readonly string[];
}

/** Colours of the vertices' feature, or of a field's values at them, in colour mode `field`. */
export interface FieldColors {
  /** Whether meshes have values of the field. */
  readonly ofValues: boolean;
  /** Values at which the feature is 0 and 1, if it is the feature's. */
  readonly known: readonly [number, number];
  /** Values of the first and the last colour. */
  readonly range: readonly [number, number];
  readonly log: boolean;
  /** Positions of the isolines between the first colour and the last, 0 to 1. */
  readonly lines: readonly number[];
}

/** As the shaders need them. */
function scaleOf({ ofValues, known, range: [low, high], log }: FieldColors): Vector4 {
  const [from, to] = ofValues ? [0, 1] : known;
  if (log) return new Vector4(from, to - from, Math.log2(low), 1 / Math.log2(high / low));
  return new Vector4((to - from) / (high - low), (from - low) / (high - low), 0, 0);
}

/** Materials of one surface. */
export class SurfaceMaterials {
  private look = DEFAULT_LOOK;
  private surfaceStyle = DEFAULT_STYLE;
  private planes = 0;
  private readonly materials = new Map<string, Material | Material[]>();
  private readonly ramp: Uint8Array<ArrayBuffer>;
  private readonly levels: readonly string[];
  private transferTable: Uint8Array<ArrayBuffer>;
  private valueTable: Uint8Array<ArrayBuffer>;
  private readonly alphaUniform: IUniform<number> = { value: 0 };
  private readonly opacity: IUniform<number> = { value: 1 };
  private readonly tint: IUniform<Color> = { value: new Color() };
  private readonly colors: IUniform<DataTexture>;
  private readonly regions: IUniform<DataTexture> = { value: regionTexture([]) };
  private hasRegions = false;
  private readonly scale: IUniform<Vector4> = { value: new Vector4(1, 0, 0, 0) };
  private isLog = false;
  private ofValues = false;
  private readonly isolines: IUniform<Float32Array> = { value: new Float32Array(MAX_ISOLINES) };
  private readonly isolineCount: IUniform<number> = { value: 0 };

  constructor(
    /** Its number. */
    private readonly surface: number,
    private readonly shared: SharedUniforms,
    { transfer, importance, levels }: ColorTables,
  ) {
    this.transferTable = transfer;
    this.ramp = importance;
    this.valueTable = importance;
    this.levels = levels;
    this.colors = { value: row(linearFromSrgb(transfer)) };
    this.recolor();
  }

  get style(): SurfaceStyle {
    return this.surfaceStyle;
  }

  set style(style: SurfaceStyle) {
    this.surfaceStyle = style;
    this.opacity.value = style.opacity;
    this.recolor();
  }

  /** The material of a pass. If colour shows levels, one for each level, for meshes with a group for each level. */
  of(pass: Pass): Material | Material[] {
    const { material, flat } = this.look;
    const { colorMode } = this;
    const colored = pass === "opaque" || pass === "peel";
    const regions = this.hasRegions && colorMode === "transfer";
    const { source } = this;
    const isolines = colorMode === "field" && this.isolineCount.value > 0;
    const ofValues = colorMode === "field" && this.ofValues;
    const kind = colored ? [material, source, flat, colorMode === "level", regions, isolines, ofValues] : [];
    return this.cached([pass, this.planes, ...kind].join(), () => {
      if (!colored) return this.mask(pass);
      const variant = { shading: SHADINGS[material], source, ofValues, flat, peel: pass === "peel", regions, isolines } as const;
      if (colorMode !== "level") return this.colored(variant, this.tint);
      return this.levels.map((color) => this.colored(variant, { value: new Color(color) }));
    });
  }

  /** The material of the triangles' edges. */
  get wire(): Material {
    return this.cached(`wire,${this.planes}`, () => {
      const uniforms = { wireColor: this.shared.wireColor, wireOpacity: { value: 0.42 } };
      const flags = { wireframe: true, transparent: true, premultipliedAlpha: true, depthWrite: false };
      return this.make(WIRE_FRAGMENT, uniforms, flags);
    }) as Material;
  }

  setLook(look: Look): void {
    this.look = look;
    this.recolor();
  }

  /** Number of planes that cut the surface; the planes themselves are shared. */
  set clippingPlanes(count: number) {
    this.planes = count;
  }

  /** Weight of the feature against smoothness. */
  get alpha(): number {
    return this.alphaUniform.value;
  }

  set alpha(alpha: number) {
    this.alphaUniform.value = alpha;
  }

  /** RGBA over the blended feature: colour and importance. */
  set transfer(bytes: Uint8Array<ArrayBuffer>) {
    this.transferTable = bytes;
    this.recolor();
  }

  /** Regions that have colours of their own, while the transfer table gives the others. */
  set coloredRegions(regions: readonly ColoredRegion[]) {
    this.hasRegions = regions.length > 0;
    this.regions.value.dispose();
    this.regions.value = regionTexture(regions);
  }

  /** Values of the colours of colour mode `field`. */
  set field(colors: FieldColors) {
    this.scale.value.copy(scaleOf(colors));
    this.isLog = colors.log;
    this.ofValues = colors.ofValues;
    const lines = colors.lines.slice(0, MAX_ISOLINES);
    this.isolines.value.set(lines);
    this.isolineCount.value = lines.length;
  }

  /** RGBA over the value of a vertex, 0 to 1. */
  set values(bytes: Uint8Array<ArrayBuffer>) {
    this.valueTable = bytes;
    this.recolor();
  }

  private cached(key: string, make: () => Material | Material[]): Material | Material[] {
    let found = this.materials.get(key);
    if (found === undefined) {
      found = make();
      this.materials.set(key, found);
    }
    return found;
  }

  private colored(variant: ProgramVariant, tint: IUniform<Color>): ShaderMaterial {
    const { nearer, opaque, isolineWidth } = this.shared;
    const { scale, isolines, isolineCount } = this;
    const uniforms = { colors: this.colors, regions: this.regions, tint, nearer, opaque, opacity: this.opacity, scale, isolines, isolineCount, isolineWidth };
    // The offset avoids depth fighting with the edges. Layers have none, because a layer's depth is compared with that of the previous layer.
    const flags = variant.peel ? {} : { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    const material = this.make(surfaceFragment(variant), uniforms, { side: DoubleSide, ...flags });
    if (variant.regions) material.defines["REGIONS"] = "";
    if (variant.ofValues) {
      material.defines["FIELD_VALUES"] = "";
      Object.assign(material.defaultAttributeValues, { fieldValue: [NO_VALUE] });
    }
    if (variant.source === "value") {
      material.defines["VALUE"] = "";
      Object.assign(material.defaultAttributeValues, { value: [NO_VALUE] });
    }
    return material;
  }

  private mask(pass: Pass): ShaderMaterial {
    if (pass === "pick") return this.make(PICK_FRAGMENT, { surface: { value: this.surface } }, { side: DoubleSide });
    if (pass === "normal") return this.make(NORMAL_FRAGMENT, {}, { side: DoubleSide });
    const bit = 1 << this.surface;
    return this.make(MASK_FRAGMENT, {}, {
      side: pass === "inside" ? BackSide : FrontSide,
      colorWrite: false,
      stencilWrite: true,
      stencilWriteMask: bit,
      stencilRef: pass === "inside" ? bit : 0,
      stencilZPass: ReplaceStencilOp,
    });
  }

  private make(fragmentShader: string, uniforms: Record<string, IUniform>, flags: Partial<ShaderMaterial>): ShaderMaterial {
    const { worldFromGrid, normalScale, clipPlanes, valueRange } = this.shared;
    return Object.assign(
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader,
        defines: { PLANES: this.planes },
        // Not cloned, so that all materials share the values.
        uniforms: { alpha: this.alphaUniform, worldFromGrid, normalScale, clipPlanes, valueRange, ...uniforms },
      }),
      flags,
    );
  }

  private get source(): ProgramVariant["source"] {
    const { colorMode } = this;
    if (colorMode === "field") return this.isLog ? "logScale" : "scale";
    return colorMode === "material" || colorMode === "level" ? "tint" : colorMode === "value" ? "value" : "table";
  }

  /** A surface with a colour of its own shows that. */
  private get colorMode(): Look["colorMode"] {
    return this.surfaceStyle.color === undefined ? this.look.colorMode : "material";
  }

  private recolor(): void {
    const { material } = this.look;
    this.tint.value.set(this.surfaceStyle.color ?? SHADINGS[material].color);
    const bytes = { material: undefined, level: undefined, transfer: this.transferTable, field: this.transferTable, importance: lookUp(this.transferTable, this.ramp), value: this.valueTable }[this.colorMode];
    if (bytes === undefined) return;
    this.colors.value.dispose();
    this.colors.value = row(linearFromSrgb(bytes));
  }
}
