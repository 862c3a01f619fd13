/** How different colours look, to normal and to colour-blind eyes. */

type Rgb = readonly [number, number, number];

/** Of linear light; Machado, Oliveira and Fernandes 2009, severity 1. */
export const EYES = {
  normal: [1, 0, 0, 0, 1, 0, 0, 0, 1],
  protanopia: [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
  deuteranopia: [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.01182, 0.04294, 0.968881],
} as const;

const LMS = [0.4122214708, 0.5363325363, 0.0514459929, 0.2119034982, 0.6806995451, 0.1073969566, 0.0883024619, 0.2817188376, 0.6299787005];
const OKLAB = [0.2104542553, 0.793617785, -0.0040720468, 1.9779984951, -2.428592205, 0.4505937099, 0.0259040371, 0.7827717662, -0.808675766];

function times(m: readonly number[], [x, y, z]: Rgb): [number, number, number] {
  const row = (i: number) => (m[i] ?? 0) * x + (m[i + 1] ?? 0) * y + (m[i + 2] ?? 0) * z;
  return [row(0), row(3), row(6)];
}

/** Lightness and two opponent colours of `#rrggbb` as these eyes see it, in Oklab. */
export function seen(color: string, eyes: keyof typeof EYES): Rgb {
  const linear = [1, 3, 5].map((i) => {
    const c = parseInt(color.slice(i, i + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  }) as [number, number, number];
  const light = times(EYES[eyes], linear).map((c) => Math.max(c, 0)) as [number, number, number];
  return times(OKLAB, times(LMS, light).map(Math.cbrt) as [number, number, number]);
}

/** ΔE in Oklab times 100: about 2 can just be told apart side by side. */
export function difference(a: string, b: string, eyes: keyof typeof EYES): number {
  const [p, q] = [seen(a, eyes), seen(b, eyes)];
  return 100 * Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
}
