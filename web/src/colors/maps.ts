/**
 * Perceptually uniform colour maps, as equidistant colours that are interpolated. Pure.
 *
 * batlow and vik: Scientific colour maps, copyright 2020 Fabio Crameri, MIT license. The others as in d3-scale-chromatic, copyright 2010 to 2026 Mike
 * Bostock, ISC license; so is the map of distances, a part of its inferno. ylorrd, ylor (its part on which edges are seen), ylgnbu, greys, rdbu and puor: ColorBrewer, copyright 2002 Cynthia
 * Brewer, Mark Harrower, and The Pennsylvania State University, Apache license 2.0.
 */

// prettier-ignore
export const COLOR_MAPS = {
  batlow: [
    "#011959", "#0d315d", "#114360", "#165262", "#226061", "#356a59", "#4d734d", "#667a3f", "#818232", "#a08a2b", "#bf9035",
    "#db954c", "#f29d6c", "#fca891", "#fdb4b4", "#fcc0d6", "#faccfa",
  ],
  viridis: [
    "#440154", "#48186a", "#472d7b", "#424086", "#3b528b", "#33638d", "#2c728e", "#26828e", "#21918c", "#1fa088", "#28ae80",
    "#3fbc73", "#5ec962", "#84d44b", "#addc30", "#d8e219", "#fde725",
  ],
  cividis: [
    "#002051", "#012b65", "#11366c", "#26426e", "#3c4d6e", "#51586e", "#62646f", "#727071", "#7f7c75", "#8c8877", "#9a9478",
    "#a9a177", "#bbaf71", "#cebd68", "#e2cb5c", "#f3da4f", "#fdea45",
  ],
  vik: [
    "#001261", "#021f69", "#022b71", "#023779", "#034481", "#045089", "#0c5e92", "#1b6d9b", "#2f7ca6", "#478db1", "#609dbc",
    "#79adc7", "#92bdd2", "#acccdc", "#c5dbe5", "#dce5e9", "#ece5e1", "#eedacf", "#e9cbb9", "#e2bba4", "#dcab8f", "#d59c7b",
    "#cf8e68", "#c97f55", "#c37243", "#bc6331", "#b3531f", "#a5400e", "#932e06", "#832106", "#741506", "#660a07", "#590008",
  ],
  magma: [
    "#000004", "#0a0822", "#1d1147", "#36106b", "#51127c", "#6a1c81", "#832681", "#9c2e7f", "#b73779", "#d0416f", "#e75263",
    "#f56b5c", "#fc8961", "#fea772", "#fec488", "#fde2a3", "#fcfdbf",
  ],
  inferno: [
    "#000004", "#0b0724", "#210c4a", "#3d0965", "#57106e", "#71196e", "#8a226a", "#a32c61", "#bc3754", "#d24644", "#e45a31",
    "#f1731d", "#f98e09", "#fcac11", "#f9cb35", "#f2ea69", "#fcffa4",
  ],
  plasma: [
    "#0d0887", "#310597", "#4c02a1", "#6600a7", "#7e03a8", "#9511a1", "#aa2395", "#bc3587", "#cc4778", "#da5a6a", "#e66c5c",
    "#f0804e", "#f89540", "#fdac33", "#fdc527", "#f8df25", "#f0f921",
  ],
  cubehelix: [
    "#000000", "#150b1d", "#1b1d3b", "#17374d", "#16534c", "#236a3e", "#437731", "#717b32", "#a07949", "#c47a74", "#d483a7",
    "#d197d3", "#c7b3ed", "#c1cff3", "#cae7f0", "#e2f6f0", "#ffffff",
  ],
  ylorrd: [
    "#ffffcc", "#fff6b6", "#ffeda0", "#ffe38b", "#fed676", "#fec562", "#feb250", "#fd9f45", "#fd893c", "#fc6d33", "#f8502b",
    "#ef3524", "#e11e20", "#cf0e21", "#b90424", "#9e0126", "#800026",
  ],
  ylgnbu: [
    "#ffffd9", "#f6fbc6", "#eaf7b8", "#d9f0b3", "#c1e7b5", "#a3dbb8", "#81cebb", "#61c1bf", "#45b4c2", "#30a3c1", "#248fbd",
    "#2077b4", "#2260a9", "#234a9d", "#20378d", "#162975", "#081d58",
  ],
  ylor: [
    "#ffffcc", "#fff9bd", "#fff3ae", "#ffec9f", "#ffe691", "#fede83", "#fed574", "#fec966", "#febd59", "#feb04f", "#fea347",
    "#fd9540", "#fd853a", "#fc7234", "#fa5e2f", "#f74a29", "#f03824",
  ],
  greys: [
    "#ffffff", "#f7f7f7", "#efefef", "#e4e4e4", "#d8d8d8", "#cbcbcb", "#bbbbbb", "#a9a9a9", "#979797", "#858585", "#737373",
    "#626262", "#505050", "#3b3b3b", "#262626", "#131313", "#000000",
  ],
  rdbu: [
    "#67001f", "#941127", "#b82d35", "#d1574b", "#e48268", "#f3aa8c", "#faccb4", "#fae4d8", "#f2efee", "#deebf2", "#bfdceb",
    "#98c7df", "#6bacd0", "#448ec1", "#2a71ae", "#17518e", "#053061",
  ],
  puor: [
    "#2d004b", "#461a70", "#5f3d8f", "#7b67a8", "#998ebf", "#b5b0d4", "#cecde4", "#e3e4ee", "#f3eeea", "#fbe7cd", "#fdd5a0",
    "#fabb6e", "#ee9d3d", "#d97e1a", "#be630b", "#9f4e07", "#7f3b08",
  ],
} as const;

/** `vik`, `rdbu` and `puor` are diverging, for values on both sides of one in the middle; the others go from low to high. */
export type ColorMapName = keyof typeof COLOR_MAPS;

/** Colours of distances, from none to far: light at the distances of most of a surface, so that its shape is visible, then ever darker. */
// prettier-ignore
export const DISTANCE_COLORS: ColorStops = [
  "#f5f992", "#f3e55d", "#f9cb35", "#fcb216", "#fb9906", "#f68013", "#ee6a24", "#e25734", "#d34743", "#c13a50", "#ae305c",
  "#9a2865", "#85216b", "#6f196e", "#5a116e", "#450a69", "#2f0a5b",
];

/** Colours `#rrggbb`, equidistant over [0, 1]. */
export type ColorStops = readonly string[];

/** Red, green and blue, 0 to 255 each, at `t` in [0, 1]. */
export function colorAt(stops: ColorStops, t: number): readonly [number, number, number] {
  const last = stops.length - 1;
  const at = Math.min(1, Math.max(0, t)) * last;
  const low = Math.min(Math.floor(at), Math.max(0, last - 1));
  const [a, b] = [bytes(stops[low]), bytes(stops[Math.min(low + 1, last)])];
  const mix = (i: 0 | 1 | 2) => a[i] + (b[i] - a[i]) * (at - low);
  return [mix(0), mix(1), mix(2)];
}

/** RGBA bytes over [0, 1], colours in sRGB. */
export function colorTable(stops: ColorStops, size = 256): Uint8Array<ArrayBuffer> {
  const table = new Uint8Array(4 * size);
  for (let i = 0; i < size; i += 1) {
    const [r, g, b] = colorAt(stops, i / (size - 1));
    table.set([r + 0.5, g + 0.5, b + 0.5, 255], 4 * i);
  }
  return table;
}

function bytes(color: string | undefined): readonly [number, number, number] {
  const value = parseInt(color?.slice(1) ?? "0", 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}
