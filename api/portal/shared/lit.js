// Templates of the page (lit-html). A value in a template becomes text, never markup: names come from clients.

import { html, noChange } from "../vendor/lit-html/lit-html.js";
import { Directive, directive } from "../vendor/lit-html/directive.js";

export { html, nothing, render, svg } from "../vendor/lit-html/lit-html.js";
export { live } from "../vendor/lit-html/directives/live.js";
export { ref } from "../vendor/lit-html/directives/ref.js";
export { repeat } from "../vendor/lit-html/directives/repeat.js";

class Typed extends Directive {
  render() { return noChange; }

  update({ element }, [value]) {
    const text = value === null || value === undefined ? "" : String(value);
    if (element !== document.activeElement && element.value !== text) element.value = text;
    return noChange;
  }
}

// Value of a field, as `.value=${typed(value)}`: it is left alone while somebody types in it.
export const typed = directive(Typed);

class Styled extends Directive {
  render() { return noChange; }

  update({ element }, [properties]) {
    for (const [name, value] of Object.entries(properties)) element.style.setProperty(name, value);
    return noChange;
  }
}

// Custom properties of an element, as `<span ${styled({ "--tint": color })}>`: the page's policy allows no style attributes.
export const styled = directive(Styled);

// Text of the service, with `code` in backticks.
export const prose = (text) => text.split("`").map((part, index) => (index % 2 ? html`<code>${part}</code>` : part));
