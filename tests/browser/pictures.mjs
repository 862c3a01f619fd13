/**
 * Renders the pictures of the mesher's steps in docs/images, after figures 3 to 6 of the paper: `node pictures.mjs FOLDER`, from
 * the meshes that the example `paper_figures` of isopeel-reference wrote to FOLDER.
 */

import { mkdirSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { CHROMIUM_FLAGS, startBrowser } from "./harness.mjs";

const IMAGES = resolve(import.meta.dirname, "../../docs/images");
const THREE = resolve(import.meta.dirname, "../../web/node_modules/three/build");
const ORIGIN = "http://pictures.localhost";

/** The colours of the viewer's legend, level 0 first. */
const LEVELS = ["#a3260f", "#ea7d2c", "#f7e07a", "#2b9a84", "#79bdf0", "#4a3f9f"];

/**
 * Cameras: what they look at (mm from the volume's corner), from which direction, how far to the right and up the picture's
 * middle lies (mm), and its height (mm). Most of the head rest, behind, is cut off.
 */
const HEAD = { target: [122, 128, 82], direction: [0.7, 0.62, 0.46], pan: [-22, -8], height: 205 };
const TEMPLE = { ...HEAD, pan: [-8, 34], height: 60 };
const SUTURE = { ...HEAD, pan: [-14, 42], height: 34 };

const PICTURES = {
  refinement: {
    size: [460, 430],
    panels: [
      { file: "coarse.bin", camera: HEAD, caption: "Coarse vertices, from the cubes' corners alone" },
      { file: "refined.bin", camera: HEAD, caption: "Refined: searched for along the cubes' edges" },
      { file: "full.bin", camera: HEAD, caption: "For comparison: every cell" },
      { file: "coarse.bin", camera: TEMPLE, wire: true },
      { file: "refined.bin", camera: TEMPLE, wire: true },
      { file: "full.bin", camera: TEMPLE, wire: true },
    ],
    columns: 3,
  },
  cracks: {
    size: [690, 560],
    panels: [
      { file: "refined.bin", camera: SUTURE, wire: true, cracks: true, caption: "Cracks where levels meet" },
      { file: "patched.bin", camera: SUTURE, wire: true, cracks: true, caption: "Patched" },
    ],
    columns: 2,
  },
  levels: {
    size: [690, 620],
    panels: [
      { file: "patched.bin", camera: HEAD, levels: true, caption: "Coloured by level" },
      { file: "patched.bin", camera: TEMPLE, levels: true, wire: true, caption: "Nearer" },
    ],
    columns: 2,
    legend: true,
  },
};

/** Runs in the page. */
async function draw({ name, panels, size, columns, legend, colors }) {
  const DISTANCE = 500;
  const THREE = await import("/three/three.module.js");
  document.body.replaceChildren();
  const grid = Object.assign(document.createElement("main"), { id: name });
  grid.style.gridTemplateColumns = `repeat(${columns}, ${size[0]}px)`;
  document.body.append(grid);
  const counts = {};
  for (const panel of panels) {
    const bytes = await (await fetch(`/meshes/${panel.file}`)).arrayBuffer();
    const n = new DataView(bytes).getUint32(0, true);
    const levels = new Uint8Array(bytes, 4 + 72 * n, n);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes, 4, 9 * n), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(bytes, 4 + 36 * n, 9 * n), 3));
    const shades = new Float32Array(9 * n);
    const palette = colors.map((c) => new THREE.Color(panel.levels ? c : "#d9cfc0").toArray());
    for (let corner = 0; corner < 3 * n; corner += 1) shades.set(palette[levels[Math.trunc(corner / 3)]], 3 * corner);
    geometry.setAttribute("color", new THREE.BufferAttribute(shades, 3));
    counts[panel.file] = n;

    const scene = new THREE.Scene();
    scene.background = new THREE.Color("#ffffff");
    const front = { side: THREE.FrontSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    scene.add(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.75, ...front })));
    // Through cracks the inside is seen, in a colour of its own.
    const inside = new THREE.MeshBasicMaterial({ color: panel.cracks ? "#d4351c" : "#5b5750", side: THREE.BackSide });
    scene.add(new THREE.Mesh(geometry, inside));
    if (panel.wire) {
      const lines = { color: "#20242c", wireframe: true, transparent: true, opacity: 0.35 };
      scene.add(new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(lines)));
    }
    const { target, direction, pan, height } = panel.camera;
    const half = height / 2;
    const wide = (half * size[0]) / size[1];
    const camera = new THREE.OrthographicCamera(-wide, wide, half, -half, 0, DISTANCE + 75);
    camera.up.set(0, 0, 1);
    camera.position.set(...target).addScaledVector(new THREE.Vector3(...direction).normalize(), DISTANCE);
    camera.lookAt(...target);
    camera.translateX(pan[0]).translateY(pan[1]);
    const key = new THREE.DirectionalLight("#ffffff", 2.6);
    key.position.set(-0.6, 0.8, 1).applyQuaternion(camera.quaternion);
    scene.add(key, new THREE.HemisphereLight("#ffffff", "#8a8f99", 0.9), camera);

    const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    renderer.setPixelRatio(2);
    renderer.setSize(...size);
    renderer.render(scene, camera);
    const figure = document.createElement("figure");
    const image = Object.assign(new Image(...size), { src: renderer.domElement.toDataURL() });
    await image.decode();
    figure.append(image);
    if (panel.caption) {
      const text = `${panel.caption} · ${n.toLocaleString("en")} triangles`;
      figure.append(Object.assign(document.createElement("figcaption"), { textContent: text }));
    }
    grid.append(figure);
    renderer.dispose();
    renderer.forceContextLoss();
  }
  if (legend) {
    const key = document.createElement("footer");
    colors.forEach((color, level) => {
      const mark = Object.assign(document.createElement("i"), { style: `background:${color}` });
      key.append(mark, `level ${level}: ${1 << level}³ cells`);
    });
    grid.append(key);
  }
  return counts;
}

const STYLE = `
  body { margin: 0; background: #fff; font: 15px/1.4 "DejaVu Sans", sans-serif; color: #23272f }
  main { display: inline-grid; gap: 10px; padding: 10px }
  figure { margin: 0 } img { display: block; border: 1px solid #dfe2e7; box-sizing: border-box }
  figcaption { padding: 6px 2px 2px; text-align: center }
  footer { grid-column: 1 / -1; display: flex; gap: 8px; justify-content: center; align-items: center }
  footer i { width: 14px; height: 14px; border-radius: 3px; margin-left: 14px }`;

const folder = process.argv[2];
if (folder === undefined) throw new Error("expected the folder that the example paper_figures wrote to");
const only = process.argv[3];
mkdirSync(IMAGES, { recursive: true });
const browser = await startBrowser(CHROMIUM_FLAGS);
try {
  const page = await browser.newPage({ viewport: { width: 1440, height: 1000 } });
  page.on("pageerror", (error) => console.error(error));
  await page.route(`${ORIGIN}/**`, (route) => {
    const { pathname } = new URL(route.request().url());
    const [, kind, file] = /^\/(three|meshes)\/([\w.-]+)$/.exec(pathname) ?? [];
    if (kind === undefined) return route.fulfill({ contentType: "text/html", body: `<!doctype html><style>${STYLE}</style>` });
    const from = kind === "three" ? THREE : folder;
    return route.fulfill({
      contentType: kind === "three" ? "text/javascript" : "application/octet-stream",
      body: readFileSync(join(from, file)),
    });
  });
  for (const [name, picture] of Object.entries(PICTURES).filter(([name]) => only === undefined || name === only)) {
    await page.goto(`${ORIGIN}/`);
    const counts = await page.evaluate(draw, { name, ...picture, colors: LEVELS });
    const path = join(IMAGES, `${name}.png`);
    await page.locator("main").screenshot({ path });
    console.log(`${path}: ${JSON.stringify(counts)}`);
  }
} finally {
  await browser.close();
}
