// Titles of the jobs of a capture, by what tells them apart.

import { moment } from "../shared/format.js";
import { choiceText } from "../shared/resources.js";
import { STATES } from "../shared/strings/common.js";
import { OPTIONS } from "../shared/strings/send.js";

/** Title of each job by its id: the choices in which they differ, the revision, and the time where that is not enough. */
export function titleJobs(jobs, { choices }) {
  const isVaried = ({ name }) => new Set(jobs.map(({ spec }) => JSON.stringify(spec[name] ?? null))).size > 1;
  const varied = choices.filter(isVaried);
  const choiceWords = ({ spec, revision }) => [
    ...varied.map((choice) => wordsOfChoice(choice, spec[choice.name])),
    revision > 0 ? STATES.revision(revision) : null,
  ].filter(Boolean).join(", ");
  const words = new Map(jobs.map((job) => [job.id, choiceWords(job)]));
  const isAlone = (text) => text !== "" && [...words.values()].filter((other) => other === text).length === 1;
  return new Map(jobs.map(({ id, created_at: created }) => {
    const text = words.get(id);
    return [id, isAlone(text) ? text : [text, moment(created)].filter(Boolean).join(", ")];
  }));
}

function wordsOfChoice(choice, value) {
  if (choice.kind === "flag") return `${choice.label}: ${value ? OPTIONS.yes : OPTIONS.no}`;
  return `${choice.label}: ${value === null || value === undefined ? choice.unset ?? OPTIONS.none : choiceText(choice, value)}`;
}
