// Requests while the service can't be reached: they are made again when it answers.

const AGAIN_MS = 3000;

let answering = null; // promise of the next answer, which all waiting requests share

// Result of a task, which is tried again whenever the service was away. `away(problem)` hears of each failure, and
// `isOver()` tells that nobody waits for the result any more; the last problem is then thrown.
export async function persistently(task, { away = () => {}, isOver = () => false } = {}) {
  for (;;) {
    try {
      return await task();
    } catch (problem) {
      if (!problem.isAway || isOver()) throw problem;
      away(problem);
      answering ??= nextAnswer().finally(() => { answering = null; });
      await answering;
      if (isOver()) throw problem;
    }
  }
}

async function nextAnswer() {
  do await pause(); while (!await reached());
}

// Whether the service answers.
export function reached() {
  return fetch("/healthz").then(({ ok }) => ok, () => false);
}

// A moment, cut short when the browser is connected again.
function pause() {
  return new Promise((resolve) => {
    const done = () => {
      clearTimeout(timer);
      removeEventListener("online", done);
      resolve();
    };
    const timer = setTimeout(done, AGAIN_MS);
    addEventListener("online", done);
  });
}
