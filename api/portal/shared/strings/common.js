// Texts that several views share: numbers with their nouns, states of jobs, problems.
//
// The files of this folder have all texts of the page that a person reads, by view: plain objects and small functions. A
// translation replaces them. Sentences of the service, such as options, stages and problems, come from its API. Backticks mark
// code in texts that a template shows by `prose`.

const count = (number, one, many = `${one}s`) => `${number} ${number === 1 ? one : many}`;

export const COUNTS = {
  bones: (number) => count(number, "bone"),
  cameras: (number) => count(number, "camera"),
  captures: (number) => count(number, "capture"),
  clips: (number) => count(number, "clip"),
  files: (number) => count(number, "file"),
  findings: (number) => count(number, "finding"),
  folders: (number) => count(number, "folder"),
  frames: (number) => count(number, "frame"),
  instants: (number) => count(number, "instant"),
  people: (number) => count(number, "person", "people"),
  phones: (number) => count(number, "phone"),
  takes: (number) => count(number, "take"),
  times: (number) => count(number, "time"),
};

export const FORMATS = {
  bytes: ["B", "kB", "MB", "GB", "TB"],
  seconds: (number) => `${number} s`,
  minutes: (number) => `${number} min`,
  hours: (number) => `${number} h`,
  percent: (number) => `${number} %`,
  today: (time) => `today, ${time}`,
  dated: (name, day) => `${name} (${day})`,
};

export const COMMON = {
  calibration: "Calibration",
  cameras: "Cameras",
  camera: "Camera",
  cancel: "Cancel",
  choose: "Choose …",
  close: "Close",
  delete: "Delete",
  fileOr: "Or a file",
  help: (about) => `Help: ${about}`,
  hz: (rate) => `${rate} Hz`,
  keep: "Keep",
  loading: "Loading …",
  more: "More",
  moreAbout: (code) => `More about ${code}`,
  name: "Name",
  none: "None",
  rename: "Rename",
  renameOf: (name) => `Rename ${name}`,
  renamed: (name) => `Renamed to ${name}.`,
  newName: (name) => `New name of ${name}`,
  save: "Save",
  warningsOf: (name) => `Warnings of ${name}`,
};

export const PROBLEMS = {
  away: "The service does not answer. The page tries again until it does.",
  choicesMissing: "The options could not be loaded. Reload the page.",
  viewMissing: "This view can't be loaded. Reload the page.",
  filesAgain: "You will have to choose the files again.",
};

export const STATES = {
  queued: "Waiting", running: "Running", canceling: "Canceling", succeeded: "Done", failed: "Failed", canceled: "Canceled", expired: "Expired",
  runningAt: (percent) => `Running ${percent}`,
  updatingAt: (percent) => `updating files ${percent}`,
  notUpdated: "Done, files not updated",
  foundNobody: "Done: no person found",
  emptied: "Done: edits removed everyone",
  doneWithWarnings: "Done, with warnings",
  attempt: (number) => `attempt ${number}`,
  revision: (number) => `revision ${number}`,
  inQueue: (number) => `number ${number} in the queue`,
  timeLeft: (time) => `about ${time} left`,
  took: (time) => `took ${time}`,
  keptUntil: (day) => `kept until ${day}`,
  done: "done",
  doneBefore: "reused",
  progress: (done, total) => `${done} of ${total}`,
  rate: (number) => `${number} frames/s`,
  shortTime: "less than a minute",
  about: (time) => `about ${time}`,
  fromJobs: "estimated from recent jobs",
  fromMeasurements: "estimated for one core; this service may be faster or slower",
};
