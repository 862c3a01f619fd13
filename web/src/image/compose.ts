/** An image of the scene: a snapshot with colour bar, scale bar and caption drawn into it, as a PNG. Loaded when an image is requested. */

import { colorAt } from "../colors/maps";
import type { ColorBar } from "../scene/colorScale";
import type { Snapshot } from "../scene/snapshot";

export interface ImageParts {
  /** Background: a CSS colour. Without one, pixels without a surface stay transparent. */
  readonly background?: string;
  /** Of texts and lines: `#rrggbb`. */
  readonly ink: string;
  /** Pixels of the image for one on the page; texts have the size that they have there. */
  readonly scale: number;
  readonly colorBar?: ColorBar;
  /** A bar of a round length in pixels of the image, from the world units of a pixel. An image whose scale differs from place to place has none. */
  readonly scaleBar?: (unitsPerPixel: number) => { readonly text: string; readonly pixels: number };
  readonly caption?: string;
  /** Signs of the surfaces, in their order. */
  readonly isovalues?: readonly SurfaceSign[];
}

/** A swatch and its text. */
export interface SurfaceSign {
  /** One colour, or those of a colour map, as `colorBar` has them. */
  readonly stops: readonly string[];
  readonly opacity: number;
  readonly text: string;
}

/** Pixels of the page. */
const MARGIN = 16;
const TEXT = 13;
/** Of the edge around texts. */
const EDGE = 3;
/** Opacity of texts at places behind the surface. */
const FAINT = 0.45;
const FONT = 'system-ui, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif';
const COLOR_BAR = { width: 14, height: 200 };
const SWATCH = { width: 22, height: 12, line: 20 };

export function composeImage(snapshot: Snapshot, parts: ImageParts): Promise<Blob> {
  return toPng(drawImage(snapshot, parts));
}

export const toPng = (picture: OffscreenCanvas): Promise<Blob> => picture.convertToBlob({ type: "image/png" });

export function drawImage({ width, height, pixels, labels, unitsPerPixel }: Snapshot, parts: ImageParts): OffscreenCanvas {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  if (context === null) throw new Error("the browser gives no canvas to draw the image on");
  // Pixels put on a canvas replace its contents, so the background is drawn under them afterwards.
  context.putImageData(new ImageData(pixels, width, height), 0, 0);
  if (parts.background !== undefined) {
    context.globalCompositeOperation = "destination-over";
    context.fillStyle = parts.background;
    context.fillRect(0, 0, width, height);
    context.globalCompositeOperation = "source-over";
  }
  const { scale, ink } = parts;
  context.fillStyle = ink;
  context.strokeStyle = ink;
  context.lineWidth = 1.5 * scale;
  context.font = `${TEXT * scale}px ${FONT}`;
  context.textBaseline = "middle";
  context.textAlign = "center";
  context.lineJoin = "round";
  const write = writer(context, parts.background ?? opposite(ink), scale);
  for (const { text, x, y, isBehind } of labels) {
    context.globalAlpha = isBehind ? FAINT : 1;
    write(text, x, y);
  }
  context.globalAlpha = 1;
  if (parts.scaleBar !== undefined && unitsPerPixel !== undefined) drawScaleBar(context, write, parts.scaleBar(unitsPerPixel), scale, height);
  if (parts.colorBar !== undefined) drawColorBar(context, write, parts.colorBar, scale, width, height);
  if (parts.isovalues !== undefined) drawIsovalues(context, write, parts.isovalues, scale);
  if (parts.caption !== undefined) drawCaption(context, write, parts.caption, scale, width, height);
  return canvas;
}

type Context = OffscreenCanvasRenderingContext2D;
type Write = (text: string, x: number, y: number) => void;

/** Writes in the context's colour with an edge in another one, so that text is legible over a dark slice and over the background. */
function writer(context: Context, edge: string, scale: number): Write {
  return (text, x, y) => {
    const { strokeStyle, lineWidth } = context;
    context.strokeStyle = edge;
    context.lineWidth = EDGE * scale;
    context.strokeText(text, x, y);
    context.strokeStyle = strokeStyle;
    context.lineWidth = lineWidth;
    context.fillText(text, x, y);
  };
}

/** White or black, whichever is farther from a colour `#rrggbb`. */
function opposite(color: string): string {
  const [r = 0, g = 0, b = 0] = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));
  return 0.299 * r + 0.587 * g + 0.114 * b < 128 ? "#ffffff" : "#000000";
}

function drawScaleBar(context: Context, write: Write, { text, pixels }: { text: string; pixels: number }, scale: number, height: number): void {
  const [left, bottom] = [MARGIN * scale, height - MARGIN * scale];
  context.beginPath();
  context.moveTo(left, bottom - 5 * scale);
  context.lineTo(left, bottom);
  context.lineTo(left + pixels, bottom);
  context.lineTo(left + pixels, bottom - 5 * scale);
  context.stroke();
  context.textAlign = "center";
  write(text, left + pixels / 2, bottom - 14 * scale);
}

/** On the right, high values above. */
function drawColorBar(context: Context, write: Write, { stops, texts, lines = [], title }: ColorBar, scale: number, width: number, height: number): void {
  const [barWidth, barHeight] = [COLOR_BAR.width * scale, Math.min(COLOR_BAR.height * scale, height / 2)];
  const [left, top] = [width - MARGIN * scale - barWidth, (height - barHeight) / 2];
  const rows = Math.ceil(barHeight);
  for (let row = 0; row < rows; row += 1) {
    const [r, g, b] = colorAt(stops, 1 - row / Math.max(1, rows - 1));
    context.fillStyle = `rgb(${r} ${g} ${b})`;
    context.fillRect(left, top + row, barWidth, 1);
  }
  context.fillStyle = context.strokeStyle;
  context.lineWidth = scale;
  context.strokeRect(left, top, barWidth, barHeight);
  context.textAlign = "right";
  texts.forEach((text, i) => {
    const share = texts.length > 1 ? i / (texts.length - 1) : 0;
    write(text, left - 6 * scale, top + (1 - share) * barHeight);
  });
  for (const { at, text } of lines) {
    const y = top + (1 - at) * barHeight;
    context.beginPath();
    context.moveTo(left - 3 * scale, y);
    context.lineTo(left + barWidth, y);
    context.stroke();
    write(text, left - 6 * scale, y);
  }
  write(title, left + barWidth, top - 20 * scale);
}

/** In the upper left corner. */
function drawIsovalues(context: Context, write: Write, signs: readonly SurfaceSign[], scale: number): void {
  const [width, height] = [SWATCH.width * scale, SWATCH.height * scale];
  const left = MARGIN * scale;
  context.textAlign = "left";
  context.lineWidth = scale;
  signs.forEach(({ stops, opacity, text }, i) => {
    const middle = (MARGIN + (i + 0.5) * SWATCH.line) * scale;
    context.globalAlpha = opacity;
    for (let column = 0; column < width; column += 1) {
      const [r, g, b] = colorAt(stops, column / Math.max(1, width - 1));
      context.fillStyle = `rgb(${r} ${g} ${b})`;
      context.fillRect(left + column, middle - height / 2, 1, height);
    }
    context.globalAlpha = 1;
    context.strokeRect(left, middle - height / 2, width, height);
    context.fillStyle = context.strokeStyle;
    write(text, left + width + 8 * scale, middle);
  });
}

/** Below the picture's middle; a long one in several lines. */
function drawCaption(context: Context, write: Write, caption: string, scale: number, width: number, height: number): void {
  const widest = width - 12 * MARGIN * scale;
  const lines: string[] = [];
  for (const word of caption.split(/\s+/)) {
    const longer = `${lines.at(-1) ?? ""} ${word}`.trim();
    if (lines.length > 0 && context.measureText(longer).width <= widest) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  context.textAlign = "center";
  lines.forEach((line, i) => write(line, width / 2, height - (MARGIN + (lines.length - 1 - i) * 1.4 * TEXT) * scale));
}
