/** Queries about the graphics device. */

/** Pause between two queries whether the GPU is done. */
const FENCE_POLL_MS = 3;

/** Whether frames are rendered by a GPU, not by a processor. */
export function hasGpu(): boolean {
  const probe = document.createElement("canvas").getContext("webgl2");
  if (probe === null) return false;
  // Some browsers give the name only in this extension. `failIfMajorPerformanceCaveat` does not reveal a SwiftShader that was asked for.
  const unmasked = probe.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL;
  const name = String(probe.getParameter(unmasked ?? probe.RENDERER));
  // Browsers allow few contexts at a time.
  probe.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** Waits until the GPU has completed all commands so far. */
export async function gpuDone(gl: WebGL2RenderingContext): Promise<void> {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  if (fence === null) return;
  do await new Promise((resolve) => setTimeout(resolve, FENCE_POLL_MS));
  while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED);
  gl.deleteSync(fence);
}
