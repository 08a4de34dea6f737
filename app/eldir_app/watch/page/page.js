// The connection to the server, the buttons and all texts. Curves: curves.js. Picture: picture.js. Walk: walk.js. Stop heating: stop.js.

import { at, begins, colour, dashes, draw } from "/curves.js";
import { drawPicture } from "/picture.js";
import { describeWalk } from "/walk.js";

const SILENT = 2000; // the server speaks twice a second; longer, and the connection is lost [ms]
const STALE = 1.5; // older data are an alarm while a run goes on [s]
const AGAIN = 700; // from a lost connection to the next try [ms]
const CURVES = ["temperatures", "currents", "contacts", "events", "begins", "marks"];

const $ = (id) => document.getElementById(id);
const empty = () => Object.fromEntries(CURVES.map((name) => [name, []]));

let run = empty();
let heard = -Infinity; // when the server last spoke [ms of performance.now]
let nowAt = 0; // when run.now was told
let fedAt = 0; // when the log last grew: a server that catches up with a long one is no alarm
let span = "near";
let socket = null;
let shown = null; // the picture: { image, t }
let instant = 0, playing = 0; // of a replay [s]; playing: when it began [ms]

function connect() {
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { run = empty(); shown = null; };
  socket.onmessage = ({ data }) => {
    heard = performance.now();
    if (typeof data === "string") take(JSON.parse(data));
    else if (!run.replay) show(new DataView(data).getFloat64(0, true), new Blob([data.slice(8)], { type: "image/jpeg" }));
  };
  socket.onclose = async () => {
    socket = null;
    try {
      const answer = await fetch("/picture?t=0");
      $("entry").hidden = answer.status !== 401;
    } catch { /* the server has gone: try again */ }
    setTimeout(connect, AGAIN);
  };
}

function take(news) {
  const opens = news.replay && !run.replay;
  if (news.anew) for (const name of CURVES) run[name] = [];
  for (const [name, value] of Object.entries(news)) {
    if (CURVES.includes(name)) for (const row of value) run[name].push(row);
    else run[name] = value;
  }
  if ("now" in news) nowAt = performance.now();
  if ("latest" in news) fedAt = performance.now();
  if (news.events) listEvents();
  if (news.plan || news.anew) legend();
  document.documentElement.dataset.replay = String(Boolean(run.replay));
  $("stop").hidden = $("caution").hidden = Boolean(run.replay);
  $("replay").hidden = !run.replay;
  $("instant").max = run.latest || 1;
  if (opens) seek(instant); // with the picture of that instant, not the log's last one
  later();
}

async function show(t, blob) {
  const image = await createImageBitmap(blob);
  if (shown) shown.image.close();
  shown = { t, image };
  later();
}

// Whether the run is over: its log is finished, or the program that wrote it has gone.
function over() {
  return !run.replay && Boolean(run.log) && (run.ended || Boolean(run.rig && run.rig.player && run.rig.player[0] === null));
}

// Why nothing heats now: how the run ended, and a latched stop. Every page says it, whoever stopped.
function stopped() {
  const last = over() ? run.events.filter(([, , part]) => part === "player").at(-1) : null;
  const latch = run.rig && run.rig.latch && run.rig.latch[0] === false ? run.rig.latch[1] : "";
  return [
    last && !last[1] ? `The run ended at ${last[0].toFixed(1)} s: ${last[3]}` : over() && !run.ended ? `The program that drove has gone${run.behind ? "; the rest of its log is being read." : ", and its log is not finished."}` : "",
    latch && `Nothing heats before eldir rig reset: ${latch}`,
  ].filter(Boolean).join("\n");
}

// The instant that the page shows [s since the start].
function present() {
  if (run.replay) return instant;
  if (run.now === null || run.now === undefined || over()) return run.latest || 0;
  return run.now + (performance.now() - nowAt) / 1000;
}

let due = 0;
function later() {
  due = due || requestAnimationFrame(() => { due = 0; paint(); });
}

function paint() {
  const now = present(), schedule = run.plan && run.plan.schedule;
  let from = 0, to = Math.max(now, 10);
  const end = schedule ? begins(schedule, run.begins).at(-1) + schedule.period_s : to;
  if (span === "all") {
    from = Math.min(0, ...run.temperatures.slice(0, 1).map((r) => r[0]));
    to = Math.max(end, run.latest || 0);
  } else {
    const reach = schedule ? Math.min(Math.max(schedule.period_s, 10), 60) : 30;
    from = now - 1.5 * reach;
    to = now + 0.5 * reach;
  }
  draw($("curves"), run, now, from, to);
  if (shown) {
    drawPicture($("picture"), shown.image, shown.t, run.marks, run.ground);
    $("picture-note").textContent = `at ${shown.t.toFixed(1)} s`;
  } else $("picture-note").textContent = run.rig ? "none" : "";
  $("picture").hidden = !shown;
  values(now);
  numbers(now, schedule, end);
}

function legend() {
  const rig = run.plan && run.plan.rig;
  $("legend").replaceChildren(...(rig ? rig.channels : []).map((entry, i) => {
    const item = document.createElement("span"), swatch = document.createElement("canvas"), value = document.createElement("b");
    swatch.width = 44;
    swatch.height = 12;
    const pen = swatch.getContext("2d");
    pen.strokeStyle = colour(i);
    pen.lineWidth = 5;
    pen.setLineDash(dashes(i).map((d) => 2 * d));
    pen.moveTo(0, 6);
    pen.lineTo(44, 6);
    pen.stroke();
    item.append(swatch, ` spring ${entry.spring} ${entry.face}, ch ${entry.channel}: `, value);
    return item;
  }));
}

function values(now) {
  const row = run.temperatures[Math.min(at(run.temperatures, now + 0.001), run.temperatures.length) - 1];
  const ampere = run.currents[Math.min(at(run.currents, now + 0.001), run.currents.length) - 1];
  $("legend").querySelectorAll("b").forEach((value, i) => {
    const celsius = row && row[i + 1] !== undefined ? `${row[i + 1].toFixed(1)} °C` : "–";
    value.textContent = ampere && ampere[i + 1] !== null ? `${celsius}, ${ampere[i + 1].toFixed(2)} A` : celsius;
  });
}

function numbers(now, schedule, end) {
  const rig = run.plan && run.plan.rig, state = run.rig || {}, driven = state.player && state.player[0] !== null;
  const lost = performance.now() - heard > SILENT;
  const age = run.now === null || run.now === undefined ? null : Math.max(now - run.latest, 0);
  const ended = over();
  const stale = !run.replay && !ended && driven && age > STALE && performance.now() - fedAt > 1000 * STALE;
  const kind = run.plan && run.plan.rehearsal ? " (rehearsal on an emulated board: nothing is heated)" : rig && rig.virtual ? " (virtual rig)" : "";
  $("name").textContent = rig ? `${rig.name}${kind}` : "eldir rig watch";
  const cycle = schedule ? cycleAt(schedule, now) : "–";
  $("mode").textContent = !run.log ? "No schedule is played now. The page shows the next run when it starts."
    : `${run.replay ? "Replay of" : run.ended ? "Ended:" : run.paused ? "Paused:" : driven ? "Running:" : "No longer driven:"} ${run.log}`;
  terms("run", [
    ["Time", now < 0 ? `begins in ${(-now).toFixed(1)} s` : `${ended ? "ended at " : ""}${now.toFixed(1)} s`],
    ["Cycle", cycle],
    ["Time left", ended ? "–" : schedule && !run.paused ? clock(Math.max(end - now, 0)) : run.paused ? "paused" : "–"],
    ["Highest", run.temperatures.length ? `${hottest(now).toFixed(1)} °C${rig ? ` of ${rig.max_temperature_c}` : ""}` : "–"],
    ["Data", age === null ? "–" : run.ended ? "complete" : ended ? "the log ends here" : `${age.toFixed(1)} s old`, stale ? "bad" : ""],
    ["Camera", ended ? "–" : run.camera_rate === null || run.camera_rate === undefined ? "none" : `${run.camera_rate} pictures/s`],
  ]);
  const mood = (pair) => [pair ? pair[1] : "–", pair && pair[0] === false ? "bad" : pair && pair[0] ? "good" : ""];
  if (run.replay) terms("rig", [["Log", run.log], ["Temperature limit", rig ? `${rig.max_temperature_c} °C` : "–"]]);
  else terms("rig", [
    ["Guardian", ...mood(state.guardian)],
    ["Program", ...mood(state.player)],
    ["Stop", ...mood(state.latch)],
    ["Disk", state.free_mb === null || state.free_mb === undefined ? "–" : `${(state.free_mb / 1000).toFixed(1)} GB free`,
      typeof state.free_mb === "number" && state.free_mb < 500 ? "bad" : ""],
  ]);
  document.documentElement.dataset.over = String(ended);
  $("heat-note").textContent = ended ? `at ${now.toFixed(1)} s, when the run ended` : "";
  orders(driven);
  starting(driven);
  $("walk").textContent = describeWalk(run, schedule, now);
  alarm(lost && run.replay ? "Connection lost, reconnecting …"
    : lost ? "Connection lost, reconnecting … Stop heating may still work. If it gives no answer, run eldir rig off or cut the heating supply."
    : run.trouble ? run.trouble
    : stale ? `No new data for ${age.toFixed(0)} s: the values on this page are old. Stop heating still works.` : run.replay ? "" : stopped());
}

// Commands to the program that drives. Stop heating does not need that program.
function orders(driven) {
  const hidden = !run.orders || !driven || run.ended;
  if (hidden && !$("orders").hidden) $("ordered").hidden = true;
  $("orders").hidden = hidden;
  $("pause").dataset.order = run.paused ? "resume" : "pause";
  $("pause").textContent = run.paused ? "Resume" : "Pause";
}

async function order(word) {
  const words = { pause: "Pausing: every contact opens.", resume: "Resumed when the springs have rested.",
    step: "Plays one cycle, then pauses.", finish: "Ends after this cycle." };
  let text = "No answer from the program that drives: use Stop heating.", taken = false;
  try {
    const answer = await fetch(`/order/${word}`, { method: "POST", signal: AbortSignal.timeout(4000) });
    if (answer.status === 401) text = "This page has no token.";
    else taken = answer.ok && (await answer.json()).taken;
  } catch { /* as without an answer */ }
  say(taken ? words[word] : text, taken ? "" : "bad");
  if (taken) setTimeout(() => $("ordered").textContent === words[word] && say("", ""), 5000);
}
// The start heats: it needs two presses, and the token.
let armed = -Infinity; // when it was pressed once [ms]
function starting(driven) {
  const sure = performance.now() - armed < 4000;
  $("start").hidden = !run.start || driven || Boolean(run.replay);
  $("start").textContent = sure ? "Press again to heat" : `Start ${run.start}`;
  $("start").className = sure ? "sure" : "";
  if (run.failure && run.failure !== told) say(`Not started: ${run.failure}`, "bad");
  told = run.failure || "";
}
let told = "";

function say(text, kind) {
  $("ordered").textContent = text;
  $("ordered").className = kind;
  $("ordered").hidden = !text;
}

$("start").onclick = async () => {
  if (performance.now() - armed > 4000) { armed = performance.now(); later(); return; }
  armed = -Infinity;
  say("Starting …", "");
  try {
    const answer = await fetch("/start", { method: "POST" });
    if (answer.status === 401) {
      $("entry").hidden = false;
      say("Not started: enter the token first.", "bad");
    } else {
      const said = await answer.json();
      say(said.taken ? "Started: contacts close when everything is proven off." : `Not started: ${said.text}`, said.taken ? "" : "bad");
      if (said.taken) setTimeout(() => $("ordered").textContent.startsWith("Started") && say("", ""), 6000);
    }
  } catch { say("Not started: the server does not answer.", "bad"); }
};
for (const button of document.querySelectorAll("#orders button")) button.onclick = () => order(button.dataset.order);

function alarm(text) {
  if ($("alarm").textContent !== text) $("alarm").textContent = text;
  $("alarm").hidden = !text;
}

function cycleAt(schedule, now) {
  const all = begins(schedule, run.begins), place = all.filter((b) => b <= now).length;
  const counted = place - schedule.conditioning_cycles;
  if (!place) return "not begun";
  return counted > 0 ? `${counted} of ${schedule.cycles}` : `conditioning ${place} of ${schedule.conditioning_cycles}`;
}

function hottest(now) {
  let most = -Infinity;
  const last = at(run.temperatures, now + 0.001);
  for (let k = 0; k < last; k += 1) for (let i = 1; i < run.temperatures[k].length; i += 1) most = Math.max(most, run.temperatures[k][i]);
  return Number.isFinite(most) ? most : NaN;
}

function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return minutes ? `${minutes} min ${String(Math.floor(seconds % 60)).padStart(2, "0")} s` : `${seconds.toFixed(0)} s`;
}

function terms(id, rows) {
  const list = $(id);
  if (list.children.length !== 2 * rows.length) {
    list.replaceChildren(...rows.flatMap(() => [document.createElement("dt"), document.createElement("dd")]));
  }
  rows.forEach(([name, text, kind], i) => {
    const term = list.children[2 * i], value = list.children[2 * i + 1];
    if (term.textContent !== name) term.textContent = name;
    if (value.textContent !== text) value.textContent = text;
    value.className = kind || "";
  });
}

function listEvents() {
  $("events").replaceChildren(...run.events.slice(-200).reverse().map(([t, good, part, text]) => {
    const item = document.createElement("li");
    for (const word of [`${t.toFixed(1)} s`, part, text]) {
      const cell = document.createElement("span");
      cell.textContent = word;
      item.append(cell);
    }
    item.className = good ? "" : "bad";
    return item;
  }));
}

// A replay: the slider chooses the instant, and pictures are asked for.
let asking = false, asked = null;
async function seek(t) {
  instant = Math.min(Math.max(t, 0), run.latest || 0);
  $("instant").value = instant;
  later();
  asked = instant;
  if (asking) return;
  asking = true;
  while (asked !== null) {
    const wanted = asked;
    asked = null;
    try {
      const answer = await fetch(`/picture?t=${wanted.toFixed(3)}`);
      if (answer.ok) await show(wanted, await answer.blob());
    } catch { break; }
  }
  asking = false;
}

function play() {
  if (!playing) return;
  seek((performance.now() - playing) / 1000);
  if (instant >= run.latest) pause();
  else setTimeout(play, 100);
}

function pause() {
  playing = 0;
  $("play").textContent = "Play";
}

$("play").onclick = () => {
  if (playing) { pause(); return; }
  if (instant >= run.latest) instant = 0;
  playing = performance.now() - 1000 * instant;
  $("play").textContent = "Pause";
  play();
};
$("instant").oninput = () => { pause(); seek(Number($("instant").value)); };
for (const button of document.querySelectorAll("#span button")) {
  button.onclick = () => {
    span = button.dataset.span;
    for (const other of document.querySelectorAll("#span button")) other.setAttribute("aria-pressed", String(other === button));
    later();
  };
}

async function enter(token) {
  const answer = await fetch("/enter", { method: "POST", headers: { authorization: `Bearer ${token}` } });
  $("entry").hidden = answer.ok;
  if (!answer.ok) $("token").select();
}
$("entry").onsubmit = (event) => { event.preventDefault(); enter($("token").value.trim()); };

async function begin() {
  const token = location.hash.slice(1);
  if (token) {
    history.replaceState(null, "", "/"); // it stays in no history and no bookmark
    await enter(token);
  }
  connect();
}

setInterval(later, 250); // clocks, and alarms about silence
window.addEventListener("resize", later);
begin();
