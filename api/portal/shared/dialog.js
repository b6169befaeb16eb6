// A question before something is lost. The focus returns to where it was.

import { html, render } from "./lit.js";

export function confirm({ title, text, action, refusal = "Keep" }) {
  return new Promise((resolve) => {
    const dialog = document.createElement("dialog");
    dialog.setAttribute("aria-labelledby", "dialog-title");
    dialog.className = "dialog";
    document.body.append(dialog);
    render(html`<form method="dialog">
      <h2 id="dialog-title">${title}</h2>
      <p>${text}</p>
      <div class="actions end">
        <button class="button" value="no" autofocus>${refusal}</button>
        <button class="button danger" value="yes">${action}</button>
      </div>
    </form>`, dialog);
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue === "yes");
      dialog.remove();
    });
    dialog.showModal();
  });
}
