// The board as a picture, which the test in Python compares with OpenCV's.

import { writeFileSync } from "node:fs";
import test from "node:test";

import { blackParts, COLS, ROWS } from "../../../../api/portal/record/board/charuco.js";

test("black parts of the board", () => writeFileSync(`${process.env.FIXTURES}/board.json`, JSON.stringify({ cols: COLS, rows: ROWS, parts: blackParts() })));
