/** The canvas of the picture: for keys, readers of the screen, and graphics devices that are lost. */

export function prepareCanvas(canvas: HTMLCanvasElement, on: { readonly lost: () => void; readonly restored: () => void }): HTMLCanvasElement {
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Surface: drag or arrow keys to turn, right-drag or shift and arrow keys to move, wheel or + and − to zoom, F to fit");
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    on.lost();
  });
  canvas.addEventListener("webglcontextrestored", on.restored);
  return canvas;
}
