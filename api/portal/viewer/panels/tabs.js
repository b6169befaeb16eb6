// Tabs, by the pattern of WAI-ARIA: arrows move between them, only the chosen one is in the order of Tab.

import { el } from "../dom.js";

let numGroups = 0;

/** Tabs of `{ id, label, element, onshow }`; `data-shown` of the element is the id of the one that is shown: at first `first`, or else the first. */
export function tabs(items, first = null) {
  const group = `look-tabs-${++numGroups}`;
  const buttons = items.map(({ id, label }, number) => el("button", {
    type: "button", role: "tab", id: `${group}-${id}`, "aria-controls": `${group}-panel-${id}`, class: "look-tab", onclick: () => show(number),
  }, label));
  const panels = items.map(({ id, element }) => el("div", { role: "tabpanel", id: `${group}-panel-${id}`, "aria-labelledby": `${group}-${id}` }, element));
  const list = el("div", { role: "tablist", class: "look-tablist", "aria-label": "Figures of the take" }, buttons);
  const show = (chosen) => {
    buttons.forEach((button, number) => {
      button.setAttribute("aria-selected", String(number === chosen));
      button.tabIndex = number === chosen ? 0 : -1;
      panels[number].hidden = number !== chosen;
    });
    element.dataset.shown = items[chosen].id;
    items[chosen].onshow?.();
  };
  list.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    const current = buttons.indexOf(document.activeElement);
    const chosen = event.key === "Home" ? 0 : event.key === "End" ? items.length - 1 : event.key in steps ? (current + steps[event.key] + items.length) % items.length : null;
    if (chosen === null || current < 0) return;
    event.preventDefault();
    show(chosen);
    buttons[chosen].focus();
  });
  const element = el("div", { class: "look-tabs" }, list, panels);
  show(Math.max(0, items.findIndex(({ id }) => id === first)));
  return element;
}
