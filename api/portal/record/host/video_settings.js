// Size and rate of the video that all phones of a recording can.

const SIZES = [[3840, 2160], [1920, 1080], [1280, 720], [960, 540], [640, 480], [640, 360], [320, 240]];
const RATES = [60, 50, 30, 25, 24, 20, 15, 10];
const [MAX_WIDTH, MAX_RATE_HZ] = [1920, 60]; // beyond them phones become hot, and files large
const NEAR_HZ = 0.5; // cameras of 30 Hz may say 29.97

/** Sizes and rates that all of some phones can, by their `capabilities`, the best first; none without a phone that tells. */
export function commonVideos(capabilities) {
  if (capabilities.length === 0) return [];
  const least = (name) => Math.min(...capabilities.map((own) => own[name]));
  // A phone that is held upright states its height first.
  const long = Math.min(...capabilities.map((own) => Math.max(own.max_width, own.max_height)));
  const short = Math.min(...capabilities.map((own) => Math.min(own.max_width, own.max_height)));
  const sizes = SIZES.filter(([width, height]) => width <= long && height <= short);
  const rates = RATES.filter((rateHz) => rateHz <= least("max_frame_rate_hz") + NEAR_HZ);
  return sizes.flatMap(([width, height]) => rates.map((rateHz) => ({ width, height, frame_rate_hz: rateHz })));
}

/** Best of the sizes and rates, within what phones record for long; null of none. */
export function bestVideo(videos) {
  return videos.find(({ width, frame_rate_hz: rateHz }) => width <= MAX_WIDTH && rateHz <= MAX_RATE_HZ) ?? null;
}

/** Size and rate as words. */
export const videoWords = ({ width, height, frame_rate_hz: rateHz }) => `${width} × ${height}, ${rateHz} Hz`;
