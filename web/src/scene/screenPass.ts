/** A pass over all pixels of a target. */

import { BufferAttribute, BufferGeometry, Camera, GLSL3, Mesh, RawShaderMaterial, Scene, type IUniform, type WebGLRenderer, type WebGLRenderTarget } from "three";

const VERTEX = /* glsl */ `
in vec3 position;
void main() { gl_Position = vec4(position, 1.0); }
`;

const PRELUDE = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
`;

export class ScreenPass<U extends Record<string, IUniform>> {
  private readonly scene = new Scene();
  private readonly camera = new Camera();
  private readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;

  constructor(
    fragmentShader: string,
    readonly uniforms: U,
    flags: Partial<RawShaderMaterial> = {},
  ) {
    const material = new RawShaderMaterial({ glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: PRELUDE + fragmentShader, uniforms, depthTest: false, depthWrite: false });
    // One triangle that covers the target.
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(Float32Array.of(-1, -1, 0, 3, -1, 0, -1, 3, 0), 3));
    this.mesh = new Mesh(geometry, Object.assign(material, flags));
    this.mesh.frustumCulled = false;
    this.scene.add(this.mesh);
  }

  render(webgl: WebGLRenderer, target: WebGLRenderTarget | null): void {
    webgl.setRenderTarget(target);
    webgl.render(this.scene, this.camera);
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
