/** Slices beside a picture, in one image. Loaded when an image is requested. */

/** Pixels of the page. */
const TEXT = 12;
const MARGIN = 8;
/** Between the crosshair's lines and their crossing. */
const GAP = 6;
const FONT = 'system-ui, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif';

export interface SlicePicture {
  readonly canvas: CanvasImageSource;
  readonly title: string;
  /** Left, right, top and bottom. */
  readonly sides: readonly [string, string, string, string];
  /** The crosshair, as shares of width and height. */
  readonly cross: readonly [number, number];
}

/**
 * @param picture `undefined`: the slices alone, in a row
 * @param side of a slice, pixels of the image
 * @param scale pixels of the image for one on the page
 */
export function placeBeside(picture: OffscreenCanvas | undefined, slices: readonly SlicePicture[], side: number, scale: number): OffscreenCanvas {
  const [width, height] = picture === undefined ? [side * slices.length, side] : [picture.width + side, Math.max(picture.height, side * slices.length)];
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  if (context === null) throw new Error("the browser gives no canvas to draw the image on");
  if (picture !== undefined) context.drawImage(picture, 0, 0);
  slices.forEach((slice, i) => {
    context.save();
    context.translate(picture === undefined ? i * side : picture.width, picture === undefined ? 0 : i * side);
    drawPane(context, slice, side, scale);
    context.restore();
  });
  return canvas;
}

function drawPane(context: OffscreenCanvasRenderingContext2D, { canvas, cross, sides, title }: SlicePicture, side: number, scale: number): void {
  context.fillStyle = "#000000";
  context.fillRect(0, 0, side, side);
  context.drawImage(canvas, 0, 0, side, side);
  const [x, y] = [cross[0] * side, cross[1] * side];
  const gap = GAP * scale;
  context.strokeStyle = "rgb(120 200 255 / 0.8)";
  context.lineWidth = scale;
  context.beginPath();
  for (const [from, to] of [[[0, y], [x - gap, y]], [[x + gap, y], [side, y]], [[x, 0], [x, y - gap]], [[x, y + gap], [x, side]]] as const) {
    context.moveTo(from[0], from[1]);
    context.lineTo(to[0], to[1]);
  }
  context.stroke();
  context.strokeStyle = "#3a424c";
  context.strokeRect(0, 0, side, side);
  context.font = `${TEXT * scale}px ${FONT}`;
  context.fillStyle = "#f2f5f7";
  const edge = MARGIN * scale;
  const middle = side / 2;
  const places = [[edge, middle, "left"], [side - edge, middle, "right"], [middle, edge, "center"], [middle, side - edge, "center"]] as const;
  context.textBaseline = "middle";
  sides.forEach((text, i) => {
    const [left = 0, top = 0, align = "center"] = places[i] ?? [];
    context.textAlign = align;
    context.fillText(text, left, top);
  });
  context.textAlign = "left";
  context.fillText(title, edge, 1.5 * edge);
}
