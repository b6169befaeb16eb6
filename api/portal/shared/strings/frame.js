// Texts of the frame of the page: navigation, signing in, and what is shown where the page can't start.

export const LANGUAGE = "en";

export const FRAME = {
  title: (view) => `${view} · Multicap`,
  shareOf: (percent, view) => `${percent} · ${view}`,
  notify: "Notify me of ends",
  skip: "Skip to the content",
  views: "Views",
  nav: { new: "New capture", captures: "Captures", record: "Record", live: "Live", calibrations: "Calibrations", plan: "Plan of a rig", scene: "Known points in pictures", jobs: "Job" },
  api: "Web API",
  help: "Help",
  caller: (name, tenant) => `${name}, ${tenant}`,
  signIn: "Sign in",
  signOut: "Sign out",
  key: "Key",
  keyHint: "The operator creates keys: `multicap keys create`.",
  keyForm: (prefix, length) => `A key is ${prefix} and ${length} letters, digits, - or _, in one piece.`,
  keyStart: (prefix) => `This text does not begin with ${prefix}.`,
  keyCharacters: "This text has other characters.",
  keyLength: (prefix, length) => `This text has ${length} after ${prefix}: copy the whole key.`,
  keyUnknown: "The form is right, but the key is of another service or was revoked. Ask the operator for a new key.",
  linkEnded: "Link ended",
  linkEndedTitle: "This link has ended or was revoked",
  linkEndedHint: "Ask the person who sent it for a new one.",
  librariesTitle: "The libraries of this page are not installed",
  librariesHints: [
    "The operator installs them by `make setup` in the checkout. A wheel or an image includes them if npm was reachable at its build.",
    "The command line and the web API work without them.",
  ],
  startTitle: "The page could not be started",
  startHint: (error) => `Reload it. If that does not help, tell the operator: ${error}`,
};
