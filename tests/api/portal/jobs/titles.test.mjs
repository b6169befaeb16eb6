// Titles of jobs, by what tells them apart.

import assert from "node:assert/strict";
import { test } from "node:test";
import { titleJobs } from "../../../../api/portal/jobs/titles.js";

const options = {
  choices: [
    { name: "method", label: "Method", kind: "one", default: "tracking", values: [{ name: "tracking", label: "Tracking" }, { name: "clustering", label: "Clustering" }] },
    { name: "detector", label: "Network", kind: "one", default: "auto", values: [{ name: "auto", label: "chosen by itself" }, { name: "movenet", label: "MoveNet" }] },
    { name: "overlay", label: "Overlay videos", kind: "flag", default: false, values: [] },
    { name: "people", label: "People", kind: "number", default: null, unset: "any number", values: [] },
  ],
};
const job = (id, more = {}, revision = 0) => ({ id, revision, created_at: "2020-05-01T10:00:00Z", spec: { method: "tracking", detector: "auto", overlay: false, people: null, ...more } });

test("jobs are named by the choices that differ, and by no other", () => {
  const titles = titleJobs([job("a"), job("b", { method: "clustering" }), job("c", { detector: "movenet" })], options);
  assert.equal(titles.get("a"), "Method: Tracking, Network: chosen by itself");
  assert.equal(titles.get("b"), "Method: Clustering, Network: chosen by itself");
  assert.equal(titles.get("c"), "Method: Tracking, Network: MoveNet");
});

test("flags, numbers that are not set, and revisions", () => {
  const titles = titleJobs([job("a", { overlay: true, people: 3 }), job("b", {}, 2)], options);
  assert.equal(titles.get("a"), "Overlay videos: yes, People: 3");
  assert.equal(titles.get("b"), "Overlay videos: no, People: any number, revision 2");
});

test("jobs with equal choices are told apart by their times", () => {
  const titles = titleJobs([job("a"), { ...job("b"), created_at: "2020-05-02T10:00:00Z" }, job("c", { people: 2 })], options);
  assert.match(titles.get("a"), /^People: any number, .*2020/);
  assert.notEqual(titles.get("a"), titles.get("b"));
  assert.equal(titles.get("c"), "People: 2");
});
