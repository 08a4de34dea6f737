// The Stop depends on nothing else of this page: an error elsewhere must not reach it.
"use strict";

(() => {
  const LONGEST = 25000; // eldir rig off answers within 20 s, whatever hangs [ms]
  const CUT = "Cut the heating supply now, or run: eldir rig off";
  let waiting = 0;

  function tell(text, kind) {
    const outcome = document.getElementById("outcome");
    outcome.textContent = text;
    outcome.className = kind;
    outcome.hidden = false;
  }

  async function stop() {
    waiting += 1;
    const mine = waiting;
    const patience = setTimeout(() => mine === waiting && tell(`No answer yet. ${CUT}`, ""), 1500);
    tell("Stopping …", "waiting");
    try {
      const answer = await fetch("/stop", { method: "POST", keepalive: true, signal: AbortSignal.timeout(LONGEST) });
      clearTimeout(patience);
      if (answer.status === 401) tell(`Not stopped: this page has no token. ${CUT}`, "");
      else if (!answer.ok && answer.status !== 409) tell(`Not stopped: the server refused (${answer.status}). ${CUT}`, "");
      else {
        const said = await answer.json();
        if (said.proven) tell(`Stopped after ${said.seconds.toFixed(2)} s.\n${said.text}`, "proven");
        else tell(`Not proven that everything is off.\n${said.text}`, "");
      }
    } catch {
      clearTimeout(patience);
      tell(`NOT STOPPED: the server of this page does not answer. ${CUT}`, "");
    }
  }

  window.addEventListener("pointerdown", (event) => {
    if (event.target.closest && event.target.closest("#stop")) stop();
  });
  window.addEventListener("click", (event) => {
    // a screen reader or Enter: no pointer came before
    if (event.detail === 0 && event.target.closest && event.target.closest("#stop")) stop();
  });
  window.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || document.documentElement.dataset.replay === "true") return;
    event.preventDefault();
    if (!event.repeat) stop();
  }, true);
  window.addEventListener("keyup", (event) => event.code === "Space" && event.preventDefault(), true);
})();
