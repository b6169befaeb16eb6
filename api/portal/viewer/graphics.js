// What the browser draws with.

let found = null;

/** `hasWebGL`: whether it draws in 3D. `isSoftware`: whether it does so without a graphics card. */
export function graphics() {
  found ??= probe();
  return found;
}

function probe() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) return { hasWebGL: false, isSoftware: true };
  const about = context.getExtension("WEBGL_debug_renderer_info");
  const name = about ? context.getParameter(about.UNMASKED_RENDERER_WEBGL) : "";
  // Browsers keep few contexts alive.
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return { hasWebGL: true, isSoftware: /swiftshader|llvmpipe|software/i.test(name) };
}
