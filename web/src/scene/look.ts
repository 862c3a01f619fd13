/** Look of the surface: materials as a table of parameters, and the user's choices. Pure. */

/** Source of colours: one colour per surface, the transfer function, a field on a scale, the level, the importance, or a value of each vertex. */
type ColorMode = "material" | "transfer" | "field" | "level" | "importance" | "value";

export type MaterialName = "ivory" | "clay" | "tissue" | "metal" | "unlit";

/** Background; `page` shows the page's own background, `transparent` is the same in an image. */
type Background = "page" | "transparent" | "black" | "white";

export interface Look {
  readonly material: MaterialName;
  readonly colorMode: ColorMode;
  /** One normal a triangle. */
  readonly flat: boolean;
  /** The triangles' edges over the surface. */
  readonly wireframe: boolean;
  readonly background: Background;
  /** Dark lines at jumps of the depth. */
  readonly silhouettes: boolean;
  /** Ambient occlusion: crevices are darker. Like silhouettes, not on screen if a processor renders, but in images. */
  readonly occlusion: boolean;
}

/** Calm at first sight: one colour, and light that shows the shape. */
export const DEFAULT_LOOK: Look = {
  material: "ivory",
  colorMode: "material",
  flat: false,
  wireframe: false,
  background: "page",
  silhouettes: false,
  occlusion: true,
};

/** Light on a material. All are constants of the shader's program: on a processor every instruction costs. */
export interface Shading {
  /** Colour of a surface that nothing else colours, sRGB. */
  readonly color: string;
  /** Ambient light from below and above, linear. */
  readonly ground: readonly [number, number, number];
  readonly sky: readonly [number, number, number];
  /** Weights of the lights over the left shoulder, from the right, and from the eye. */
  readonly key: number;
  readonly fill: number;
  readonly head: number;
  /** Amount by which light reaches around the surface, as through skin. */
  readonly wrap: number;
  /** How much darker it is when seen at a grazing angle. */
  readonly falloff: number;
  /** Highlight: its weight, and the binary logarithm of its exponent. */
  readonly gloss: number;
  readonly glossPower: number;
  /** Share of reflections of bright and dark surroundings. */
  readonly mirror: number;
}

export const SHADINGS: Readonly<Record<MaterialName, Shading>> = {
  ivory: {
    color: "#e6dcc6",
    ground: [0.15, 0.138, 0.13],
    sky: [0.27, 0.282, 0.3],
    key: 0.7,
    fill: 0.16,
    head: 0.14,
    wrap: 0,
    falloff: 0.35,
    gloss: 0.085,
    glossPower: 5,
    mirror: 0,
  },
  clay: {
    color: "#c1876a",
    ground: [0.17, 0.15, 0.145],
    sky: [0.3, 0.3, 0.31],
    key: 0.66,
    fill: 0.14,
    head: 0.12,
    wrap: 0.15,
    falloff: 0.45,
    gloss: 0,
    glossPower: 3,
    mirror: 0,
  },
  tissue: {
    color: "#d59a86",
    ground: [0.22, 0.13, 0.12],
    sky: [0.31, 0.27, 0.27],
    key: 0.6,
    fill: 0.16,
    head: 0.14,
    wrap: 0.35,
    falloff: 0.22,
    gloss: 0.13,
    glossPower: 4,
    mirror: 0,
  },
  metal: {
    color: "#b9bec6",
    ground: [0.08, 0.08, 0.085],
    sky: [0.16, 0.17, 0.19],
    key: 0.34,
    fill: 0.1,
    head: 0.06,
    wrap: 0,
    falloff: 0.1,
    gloss: 0.45,
    glossPower: 6,
    mirror: 0.55,
  },
  /** The colour itself, for figures in which a colour means something. */
  unlit: {
    color: "#d9d9d9",
    ground: [1, 1, 1],
    sky: [1, 1, 1],
    key: 0,
    fill: 0,
    head: 0,
    wrap: 0,
    falloff: 0,
    gloss: 0,
    glossPower: 0,
    mirror: 0,
  },
};

/** One of up to four surfaces. */
export interface SurfaceStyle {
  readonly visible: boolean;
  /** 0 to 1; below 1 the surface is translucent. */
  readonly opacity: number;
  /** A colour of its own, `#rrggbb`; without one it has the colours of the look. */
  readonly color: string | undefined;
}

export const DEFAULT_STYLE: SurfaceStyle = { visible: true, opacity: 1, color: undefined };

/** Surfaces that the scene can show at once, as many as the chunk header can number. */
export const MAX_SURFACES = 4;
