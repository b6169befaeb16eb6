// Elements by function calls: the viewer depends on no library for its controls.

/** Create an element: `el("button", { class: "x", onclick: f }, "text", child)`. Attributes that are null are left out. */
export function el(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== null && value !== false && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

// Outlines in a square of 24 pixels.
const ICONS = {
  play: "M7 4.5v15l12-7.5z",
  pause: "M6 5h4v14H6zM14 5h4v14h-4z",
  start: "M6 5h2v14H6zM20 5v14L9 12z",
  end: "M16 5h2v14h-2zM4 5v14l11-7z",
  back: "M17 5v14l-9-7z",
  forward: "M7 5v14l9-7z",
  loop: "M7 7h9V4l5 4.5L16 13v-3H7v4H4V9a2 2 0 0 1 2-2zM17 17H8v3l-5-4.5L8 11v3h9v-4h3v5a2 2 0 0 1-2 2z",
  previous: "M15 5l-7 7 7 7 1.6-1.6L11.200 12l5.400-5.400z",
  next: "M9 5l7 7-7 7-1.600-1.600L12.800 12 7.400 6.600z",
  right: "M9.5 18.200 3.500 12.200 5.500 10.200 9.500 14.200 18.500 5.200 20.500 7.200z",
  fill: "M3 3h7v2H5v5H3zM14 3h7v7h-2V5h-5zM3 14h2v5h5v2H3zM19 14h2v7h-7v-2h5z",
  enlarge: "M4 4h7v2H6v5H4zM13 18h5v-5h2v7h-7z",
};

/** Icon for a button; it says nothing to screen readers. */
export function icon(name) {
  const glyph = el("span", { class: "look-glyph", "aria-hidden": "true" });
  glyph.style.clipPath = `path(evenodd, "${ICONS[name]}")`;
  return glyph;
}

/** Button with an icon and a name for screen readers and for the pointer. */
export function iconButton(name, label, onclick, attributes = {}) {
  return el("button", { type: "button", class: "look-button look-icon", "aria-label": label, title: label, onclick, ...attributes }, icon(name));
}

export function clockText(seconds) {
  const hundredths = Math.max(0, Math.round(seconds * 100));
  const [minutes, rest] = [Math.floor(hundredths / 6000), hundredths % 6000];
  return `${minutes}:${String(Math.floor(rest / 100)).padStart(2, "0")}.${String(rest % 100).padStart(2, "0")}`;
}

/** Number with so many decimals, or a dash for none. */
export function figure(value, decimals = 1, unit = "") {
  return value === null || Number.isNaN(value) ? "–" : `${value.toFixed(decimals)}${unit}`;
}

// Renderer of the browser.

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
