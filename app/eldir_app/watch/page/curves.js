// Temperatures with their limit, currents, contacts, schedule and events over one time axis.

const LEFT = 44, RIGHT = 8, TOP = 16, BAND = 16, GAP = 5, AXIS = 20;
export const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#999933"];
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3]]; // a second sign besides the colour

export const colour = (i) => COLOURS[i % COLOURS.length];
export const dashes = (i) => DASHES[i % DASHES.length];

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function sharp(canvas) {
  const scale = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

// Index of the first row at or after t.
export function at(rows, t) {
  let low = 0, high = rows.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[middle][0] < t) low = middle + 1; else high = middle;
  }
  return low;
}

// A step of 1, 2 or 5 times a power of ten that gives about `count` marks.
export function step(span, count) {
  const raw = span / count, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((n) => n * power >= raw);
}

// The first switching of each cycle may be moved by pauses: [time of the news, cycle, its begin].
export function begins(schedule, moved) {
  const all = schedule.conditioning_cycles + schedule.cycles;
  const found = [];
  for (let cycle = 0, begin = schedule.settle_s, next = 0; cycle < all; cycle += 1, begin += schedule.period_s) {
    while (next < moved.length && moved[next][1] <= cycle) begin = moved[next++][2];
    found.push(begin);
  }
  return found;
}

export function draw(canvas, run, now, from, to) {
  const { pen, width, height } = sharp(canvas);
  const plan = run.plan || {}, rig = plan.rig, schedule = plan.schedule;
  const channels = rig ? rig.channels : [];
  const bands = channels.length ? channels.length * (BAND + GAP) : 0;
  const measured = run.currents.length > 0;
  const bottom = height - AXIS - bands - GAP;
  const split = measured ? TOP + (bottom - TOP) * 0.62 : bottom;
  const x = (t) => LEFT + ((t - from) / (to - from)) * (width - LEFT - RIGHT);
  const ink = style("--ink"), soft = style("--soft"), line = style("--line");
  pen.font = "12px system-ui, sans-serif";
  pen.textBaseline = "middle";

  // time axis
  const every = step(to - from, Math.max(width / 90, 3));
  pen.strokeStyle = line;
  pen.fillStyle = soft;
  pen.textAlign = "center";
  for (let t = Math.ceil(from / every) * every; t <= to; t += every) {
    stroke(pen, [[x(t), TOP], [x(t), height - AXIS]]);
    const label = `${+t.toFixed(1)} s`;
    if (x(t) < width - 16) pen.fillText(label, Math.max(x(t), LEFT), height - AXIS / 2);
  }

  const hottest = Math.max(...run.temperatures.slice(-4000).map((r) => Math.max(...r.slice(1))), 0);
  const maxTemperature = rig ? rig.max_temperature_c : null;
  const coldest = (rig ? rig.ambient_c : 20) - 4;
  plot(run.temperatures, coldest, Math.max(maxTemperature || 60, hottest) + 4, TOP, split, "°C", maxTemperature);
  if (measured) {
    const most = Math.max(...run.currents.slice(-4000).flatMap((r) => r.slice(1).map((a) => a || 0)), 1);
    plot(run.currents, 0, most * 1.1, split + 14, bottom, "A", null);
  }

  // contacts: a frame where the schedule closes one, filled where the board reports it closed
  channels.forEach((entry, i) => {
    const y = bottom + GAP + i * (BAND + GAP);
    pen.fillStyle = soft;
    pen.textAlign = "right";
    pen.fillText(`ch ${entry.channel}`, LEFT - 5, y + BAND / 2);
    pen.save();
    clip(y, BAND);
    pen.strokeStyle = line;
    stroke(pen, [[LEFT, y + BAND], [width - RIGHT, y + BAND]]);
    if (schedule) {
      pen.fillStyle = style("--plan");
      for (const begin of begins(schedule, run.begins)) {
        for (const [channel, start, length] of schedule.pulses) {
          if (channel === entry.channel) pen.fillRect(x(begin + start), y, x(start + length) - x(start), BAND);
        }
      }
    }
    pen.fillStyle = colour(i);
    const rows = run.contacts;
    for (let k = Math.max(at(rows, from) - 1, 0); k < rows.length && rows[k][0] < to; k += 1) {
      if (!rows[k][entry.channel]) continue;
      const begin = rows[k][0];
      while (k + 1 < rows.length && rows[k + 1][entry.channel]) k += 1;
      const end = k + 1 < rows.length ? rows[k + 1][0] : run.latest;
      pen.fillRect(x(begin), y + 2, Math.max(x(end) - x(begin), 1), BAND - 4);
    }
    pen.restore();
  });

  // events above, and the present instant
  for (const [t, good] of run.events) {
    if (t < from || t > to) continue;
    pen.strokeStyle = pen.fillStyle = good ? soft : style("--bad");
    if (!good) stroke(pen, [[x(t), TOP], [x(t), bottom]]);
    pen.beginPath();
    pen.moveTo(x(t), TOP);
    pen.lineTo(x(t) - 5, TOP - 9);
    pen.lineTo(x(t) + 5, TOP - 9);
    pen.fill();
  }
  pen.strokeStyle = ink;
  pen.lineWidth = 1.5;
  stroke(pen, [[x(now), TOP - 4], [x(now), height - AXIS]]);

  function clip(y, h) {
    pen.beginPath();
    pen.rect(LEFT, y, width - LEFT - RIGHT, h + 1);
    pen.clip();
  }

  function plot(rows, low, high, upper, lower, unit, limit) {
    const y = (v) => lower - ((v - low) / (high - low)) * (lower - upper);
    const tick = step(high - low, (lower - upper) / 45);
    pen.textAlign = "right";
    for (let v = Math.ceil(low / tick) * tick; v <= high; v += tick) {
      pen.strokeStyle = line;
      stroke(pen, [[LEFT, y(v)], [width - RIGHT, y(v)]]);
      pen.fillStyle = soft;
      if (limit === null || Math.abs(y(v) - y(limit)) > 9) pen.fillText(+v.toFixed(2), LEFT - 5, y(v));
    }
    pen.textAlign = "left";
    pen.fillStyle = soft;
    pen.fillText(unit, LEFT + 4, upper + 8);
    if (limit !== null) {
      pen.strokeStyle = pen.fillStyle = style("--bad");
      pen.lineWidth = 1.5;
      stroke(pen, [[LEFT, y(limit)], [width - RIGHT, y(limit)]]);
      pen.textAlign = "right";
      pen.fillText(`limit ${limit} °C`, width - RIGHT - 4, y(limit) - 8);
      pen.fillText(limit, LEFT - 5, y(limit));
    }
    pen.save();
    clip(upper, lower - upper);
    pen.lineWidth = 2;
    const first = Math.max(at(rows, from) - 1, 0), last = Math.min(at(rows, to) + 1, rows.length);
    const stride = Math.max(Math.floor((last - first) / (2 * width)), 1);
    for (let i = 1; rows.length && i < rows[0].length; i += 1) {
      pen.strokeStyle = colour(i - 1);
      pen.setLineDash(dashes(i - 1));
      pen.beginPath();
      let drawn = false;
      for (let k = first; k < last; k += stride) {
        const v = rows[k][i];
        if (v === null) { drawn = false; continue; }
        if (drawn) pen.lineTo(x(rows[k][0]), y(v)); else pen.moveTo(x(rows[k][0]), y(v));
        drawn = true;
      }
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.restore();
    pen.lineWidth = 1;
  }
}

function stroke(pen, points) {
  pen.beginPath();
  points.forEach(([px, py], i) => (i ? pen.lineTo(px, py) : pen.moveTo(px, py)));
  pen.stroke();
}
