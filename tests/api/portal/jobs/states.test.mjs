// Words of a job's state: what an edited job's files are at.

import assert from "node:assert/strict";
import { test } from "node:test";

import { hasEnded, jobState } from "../../../../api/portal/shared/jobs.js";

const job = (files) => ({ state: "succeeded", files_state: files, progress: 0.4, warnings: [{ code: "few_views", severity: "warning" }] });

test("job_whose_files_are_updated_stays_done", () => {
  assert.deepEqual(jobState(job("updating")), { words: "Done, with warnings", tone: "warn" });
  assert.equal(hasEnded(job("updating")), false);
});

test("job_whose_files_failed_is_no_plain_success", () => {
  assert.deepEqual(jobState(job("failed")), { words: "Done, files not updated", tone: "warn" });
  assert.equal(hasEnded(job("failed")), true);
});

test("job_with_current_files_tells_of_its_warnings", () => {
  assert.deepEqual(jobState(job("current")), { words: "Done, with warnings", tone: "warn" });
});
