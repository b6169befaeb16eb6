// Numbers and times as people read them.

import { FORMATS } from "./strings/common.js";

export function size(numBytes) {
  const units = FORMATS.bytes;
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(1, numBytes)) / 3));
  return `${(numBytes / 1000 ** power).toFixed(power > 1 ? 1 : 0)} ${units[power]}`;
}

// A length of time that needs no precision: time left, time taken.
export function roughly(seconds) {
  if (seconds < 90) return FORMATS.seconds(Math.max(1, Math.round(seconds)));
  return seconds < 5400 ? FORMATS.minutes(Math.round(seconds / 60)) : FORMATS.hours(Math.round(seconds / 3600));
}

// Length of a take: 0:04.2, 1:30.0, 1:02:03.
export function length(seconds) {
  const tenths = Math.round(seconds * 10);
  const [hours, minutes] = [Math.floor(tenths / 36000), Math.floor(tenths / 600) % 60];
  const rest = (tenths % 600) / 10;
  if (hours) return `${hours}:${String(minutes).padStart(2, "0")}:${String(Math.floor(rest)).padStart(2, "0")}`;
  return `${minutes}:${rest.toFixed(1).padStart(4, "0")}`;
}

// Length of a take while it is recorded, in whole seconds: 0:04, 1:30.
export const clock = (seconds) => length(Math.floor(seconds)).replace(/\.0$/, "");

export const percent = (fraction) => FORMATS.percent(Math.floor(fraction * 100));

export function moment(text) {
  const date = new Date(text);
  const isToday = date.toDateString() === new Date().toDateString();
  if (isToday) return FORMATS.today(date.toLocaleTimeString([], { timeStyle: "short" }));
  return dateAndTime(date);
}

export const dateAndTime = (date) => date.toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

export const day = (text) => new Date(text).toLocaleDateString([], { dateStyle: "medium" });

// The file's name without its ending.
export const stem = (name) => name.replace(/\.[^.]*$/, "");
