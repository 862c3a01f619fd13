/** Uploads region meshes to the GPU, some in each frame. */

import { GLSL3, RawShaderMaterial, Scene, WebGLRenderTarget, type Camera, type WebGLRenderer } from "three";
import type { Uneven } from "../world/uneven";
import { RegionMesh, type RegionMeshData } from "./regionMesh";

/** Maximum for one frame: 16 MB take a millisecond or two, so that the frame rate holds while the user turns the surface. */
const MAX_BYTES_PER_FRAME = 16 << 20;

/** three.js uploads a geometry when it is rendered first. The queue renders each mesh once into a target of one pixel. */
export class UploadQueue {
  /** In order of arrival. */
  private readonly waiting = new Map<number, RegionMesh>();
  private readonly staging = new Scene();
  private readonly target = new WebGLRenderTarget(1, 1);
  private readonly material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: "in vec3 position; void main() { gl_Position = vec4(position, 1.0); }",
    fragmentShader: "precision mediump float; out vec4 color; void main() { color = vec4(0.0); }",
  });

  /** Axes of the grid whose samples are at uneven positions: of what comes from now on. */
  uneven: Uneven | undefined;

  get empty(): boolean {
    return this.waiting.size === 0;
  }

  /** Takes ownership of the arrays. */
  push(id: number, data: RegionMeshData): void {
    const mesh = new RegionMesh(data, this.material, this.uneven);
    mesh.hideAll();
    // Outside of the camera's view too.
    mesh.object.frustumCulled = false;
    this.waiting.set(id, mesh);
  }

  drop(id: number): void {
    this.waiting.get(id)?.dispose();
    this.waiting.delete(id);
  }

  clear(): void {
    for (const mesh of this.waiting.values()) mesh.dispose();
    this.waiting.clear();
  }

  /** Uploads as many meshes as a frame allows, at least one if any waits, and returns them. */
  uploadSome(webgl: WebGLRenderer, camera: Camera): [number, RegionMesh][] {
    const batch: [number, RegionMesh][] = [];
    let bytes = 0;
    for (const [id, mesh] of this.waiting) {
      if (bytes > 0 && bytes + mesh.bytes > MAX_BYTES_PER_FRAME) break;
      bytes += mesh.bytes;
      batch.push([id, mesh]);
    }
    if (batch.length === 0) return batch;
    this.staging.add(...batch.map(([, mesh]) => mesh.object));
    webgl.setRenderTarget(this.target);
    webgl.render(this.staging, camera);
    webgl.setRenderTarget(null);
    this.staging.clear();
    for (const [id] of batch) this.waiting.delete(id);
    return batch;
  }
}
