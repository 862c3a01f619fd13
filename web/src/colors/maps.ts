/**
 * Perceptually uniform colour maps, as equidistant colours between which is interpolated. Pure.
 *
 * batlow and vik: Scientific colour maps, copyright 2020 Fabio Crameri, MIT license. viridis and cividis as in d3-scale-chromatic, copyright
 * 2010 to 2024 Mike Bostock, ISC license; so is the map of distances, a part of its inferno.
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
} as const;

/** `vik` is diverging, for values on both sides of one in the middle; the others go from low to high. */
export type ColorMapName = keyof typeof COLOR_MAPS;

/** From none to far: light where most of a surface lies, so that its shape is seen, and darker all the way. */
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
