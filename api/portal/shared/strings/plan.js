// Texts of the view Plan.

export const PLAN = {
  title: "Plan of a rig",
  empty: "State the room, the cameras and the people.",
  fields: [
    ["length_m", "Floor along X, m", 8, 1, 100, "any"],
    ["width_m", "Floor along Y, m", 6, 1, 100, "any"],
    ["people", "People", 1, 1, 100, 1],
    ["cameras", "Number of cameras", 6, 2, 128, 1],
    ["height_m", "Height of cameras, m", 2.5, 0.1, 50, "any"],
    ["field_deg", "Field of view, degrees", 70, 10, 150, "any"],
  ],
  stand: "Cameras",
  along: "New ones, evenly along the walls",
  submit: "Plan",
  result: "Result",
  covered: (percent) => `${percent} of the floor is covered: every joint is expected in two views or more.`,
  picture: "Room from above: expected errors of joints as colours, and the cameras",
  places: "Places on the floor",
  table: ["Place x, y, m", "Views of a joint", "Expected error, mm"],
  lost: "not located",
};
