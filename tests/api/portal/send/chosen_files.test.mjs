// Files that are added to a draft: rows, their names, files of folders that are dropped one after the other.

import assert from "node:assert/strict";
import test from "node:test";

import { addFiles } from "../../../../api/portal/send/files.js";

globalThis.URL.createObjectURL = () => "blob:";

function openFile(path, content = "x") {
  const file = new File([content], path.split("/").at(-1), { lastModified: 1 });
  return Object.defineProperty(file, "webkitRelativePath", { value: path.includes("/") ? path : "" });
}

async function added(draft, ...files) {
  const notes = [];
  const forgotten = [];
  await addFiles(draft, files, { notes, forget: (row) => forgotten.push(row.name), isOver: () => false });
  return { notes, forgotten, names: draft.rows.map(({ name }) => name) };
}

test("folders of cameras one after the other keep all files", async () => {
  const draft = { name: "", rows: [] };
  await added(draft, openFile("left/GX010001.MP4"));
  const { notes, forgotten, names } = await added(draft, openFile("right/GX010001.MP4", "yy"));
  assert.deepEqual(names, ["left_GX010001.MP4", "right_GX010001.MP4"]);
  assert.deepEqual([notes, forgotten], [[], []]);
});

test("a name that an upload has stays", async () => {
  const draft = { name: "", rows: [] };
  await added(draft, openFile("left/a.mp4"));
  draft.rows[0].url = "/v1/uploads/1";
  assert.deepEqual((await added(draft, openFile("right/a.mp4"))).names, ["a.mp4", "right_a.mp4"]);
});

test("another file of a name takes its place", async () => {
  const draft = { name: "", rows: [] };
  await added(draft, openFile("a.mp4"));
  const { notes, forgotten, names } = await added(draft, openFile("a.mp4", "other"));
  assert.deepEqual(names, ["a.mp4"]);
  assert.equal(forgotten.length, 1);
  assert.match(notes[0], /a\.mp4 replaces/);
});
