// How far the robot has walked, and how far samples of it walk by then in the simulation.

import { at, begins } from "/curves.js";

export function describeWalk(run, schedule, now) {
  return [filmed(run, now), predicted(run, schedule, now)].filter(Boolean).join("\n");
}

// In a replay the markers are found while the page is open already.
function filmed(run, now) {
  const found = run.marks.length ? run.marks.at(-1)[0] : 0;
  const share = run.tracked_share;
  if (run.replay && share !== null && share !== undefined && now > found) return `Finding markers, ${Math.round(100 * share)} %`;
  const row = run.marks[Math.min(at(run.marks, now + 0.001), run.marks.length) - 1];
  return row && row[1] !== null ? `Walked ${signed(row[1])} body lengths` : "";
}

// Mean and 95 % interval of the samples at this instant, as in the report. Their schedule has no pauses.
function predicted(run, schedule, now) {
  const rows = run.prediction;
  if (!rows || !schedule) return "";
  if (rows === "computing") return "Predicted: being computed …";
  if (typeof rows === "string") return rows;
  const all = begins(schedule, run.begins), cycle = all.filter((b) => b <= now).length - 1;
  if (cycle < schedule.conditioning_cycles) return "Predicted from the first cycle that counts on";
  const t = schedule.settle_s + cycle * schedule.period_s + Math.min(now - all[cycle], schedule.period_s);
  const last = rows.at(-1), counted = Math.round((last[0] - rows[0][0]) / schedule.period_s);
  const total = `${counted === schedule.cycles ? "in the whole run" : `after ${counted} cycles`} ${interval(last)}`;
  const next = at(rows, t);
  const by = t < last[0] ? `by now ${interval(between(rows[Math.max(next - 1, 0)], rows[next], t))}, ` : "";
  return `Predicted ${by}${total}: mean, and the interval for 95 % of such robots`;
}

function between(before, after, t) {
  const part = after[0] > before[0] ? (t - before[0]) / (after[0] - before[0]) : 1;
  return before.map((value, i) => value + part * (after[i] - value));
}

const interval = ([, mean, low, high]) => `${signed(mean)} (${signed(low)} to ${signed(high)})`;
const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)}`;
