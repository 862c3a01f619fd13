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
