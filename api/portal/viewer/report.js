// Script of a report: 3D view and time line of the take whose data are in the page. vendor.mjs bundles it.

import { EmbeddedStore } from "./motion/store.js";
import { Player, frameRange } from "./player.js";
import { Viewer } from "./viewer.js";

const store = new EmbeddedStore(JSON.parse(document.getElementById("take").textContent));
const { people } = store.description;
const player = new Player(frameRange([store.description]));
player.setLooping(false);
player.seek(Math.round(people.reduce((sum, { start_frame: first, num_frames: length }) => sum + (first + length / 2) / people.length, 0)));
const element = document.getElementById("viewer");
const viewer = new Viewer(element, store, player);
for (const button of document.querySelectorAll(".go")) {
  button.addEventListener("click", () => {
    viewer.goTo(Number(button.dataset.frame));
    element.scrollIntoView({ block: "nearest" });
  });
}
