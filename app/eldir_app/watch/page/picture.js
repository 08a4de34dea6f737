// The camera's picture, with the printed ground, the marks and their paths.

import { at } from "/curves.js";

const MARKS = ["#d62828", "#ebc814", "#1ea03c", "#1e5ad2", "#be28be"]; // as on the printed sheet
const TRAIL = 300; // positions of each mark
const SAME = 0.35; // marks of another instant are not drawn on a picture [s]

function drawGround(pen, ground) {
  pen.lineJoin = "round";
  pen.lineWidth = 2;
  pen.strokeStyle = ground.colour;
  pen.beginPath();
  for (const corner of ground.corners) pen.lineTo(...corner);
  pen.stroke();
}

export function drawPicture(canvas, image, t, rows, ground) {
  if (canvas.width !== image.width || canvas.height !== image.height) {
    canvas.width = image.width;
    canvas.height = image.height;
  }
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0);
  if (ground) drawGround(pen, ground);
  const end = at(rows, t + 0.01);
  if (!end) return;
  const trail = rows.slice(Math.max(end - TRAIL, 0), end), latest = rows[end - 1];
  pen.lineJoin = "round";
  for (let k = 2; k < latest.length; k += 1) {
    for (const [width, stroke] of [[4, "rgb(0 0 0 / .55)"], [2, MARKS[(k - 2) % MARKS.length]]]) {
      pen.lineWidth = width;
      pen.strokeStyle = stroke;
      pen.beginPath();
      let drawn = false;
      for (const row of trail) {
        if (row[k] && drawn) pen.lineTo(...row[k]);
        else if (row[k]) pen.moveTo(...row[k]);
        drawn = Boolean(row[k]);
      }
      pen.stroke();
    }
    if (!latest[k] || t - latest[0] > SAME) continue;
    const [x, y] = latest[k];
    pen.lineWidth = 2;
    pen.strokeStyle = "#fff";
    pen.beginPath();
    pen.arc(x, y, 9, 0, 2 * Math.PI);
    pen.stroke();
    pen.font = "600 15px system-ui, sans-serif";
    pen.lineWidth = 3;
    pen.strokeStyle = "rgb(0 0 0 / .8)";
    pen.strokeText(`m${k - 1}`, x + 12, y - 8);
    pen.fillStyle = "#fff";
    pen.fillText(`m${k - 1}`, x + 12, y - 8);
  }
}
