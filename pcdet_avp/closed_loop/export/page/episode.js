"use strict";
// Draws the moments of an episode. World frame: x to the right of the map, y up, metres; a tick is a row of every list.
(() => {
  const data = JSON.parse(document.getElementById("episode").textContent);
  const COLOURS = { floor: "#28292c", paint: "#5c5c58", solid: "#807e78", parked: "#464a50", edge: "#60646c", truth: "#46be5a",
    fused: "#ff5aaa", alone: "#5aaaff", ignored: "#9b6882", ego: "#f5f5f5", glass: "#464e5a", unit: "#ff963c", text: "#d7d7d7",
    grid: "#3a3a3a" };
  const WINDOW_M = 52, BEHIND_M = 8, SMALL_M = 1.5, LEFT_PX = 34, BOTTOM_PX = 18, TOP_PX = 20;
  const slider = document.getElementById("tick"), button = document.getElementById("play");
  const panels = data.drives.map((drive, index) => {
    const section = document.querySelectorAll(".drive")[index];
    return { drive, map: section.querySelector(".map"), speeds: section.querySelector(".speeds"),
      value: (name, text) => { section.querySelector(`[data-value="${name}"]`).textContent = text; } };
  });
  const ticks = Math.max(...data.drives.map(drive => drive.speed.length));
  let tick = data.start, playing = null;

  function corners([x, y, length, width, yaw]) {
    const c = Math.cos(yaw) / 2, s = Math.sin(yaw) / 2;
    return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) =>
      [x + a * length * c - b * width * s, y + a * length * s + b * width * c]);
  }

  function sized(canvas) {
    const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
    }
    const context = canvas.getContext("2d");
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    return [context, width, height];
  }

  function view(ego, width, height) {
    const [x0, y0, x1, y1] = data.plan.outline;
    if (document.getElementById("whole").checked) {
      const scale = Math.min(width / (x1 - x0 + 4), height / (y1 - y0 + 4));
      return { scale, left: (x0 + x1) / 2 - width / scale / 2, top: (y0 + y1) / 2 + height / scale / 2 };
    }
    const scale = width / WINDOW_M, tall = height / scale;
    if (data.follow_y) return { scale, left: ego[0] - WINDOW_M / 2, top: ego[1] + tall / 2 };
    return { scale, left: Math.min(ego[0] - BEHIND_M, x1 + 2 - WINDOW_M), top: 0.34 * tall };
  }

  function painter(context, seen) {
    const at = ([x, y]) => [(x - seen.left) * seen.scale, (seen.top - y) * seen.scale];
    const path = polygon => {
      context.beginPath();
      polygon.forEach((point, k) => k ? context.lineTo(...at(point)) : context.moveTo(...at(point)));
      context.closePath();
    };
    return {
      at,
      fill(polygon, colour) { path(polygon); context.fillStyle = colour; context.fill(); },
      outline(polygon, colour, width, dash) {
        path(polygon);
        context.lineWidth = width; context.strokeStyle = colour; context.setLineDash(dash); context.stroke();
        context.setLineDash([]);
      },
      ring(point, radius, colour, width, dash) {
        context.beginPath(); context.arc(...at(point), radius, 0, 2 * Math.PI);
        context.lineWidth = width; context.strokeStyle = colour; context.setLineDash(dash); context.stroke();
        context.setLineDash([]);
      },
      dot(point, radius, colour) {
        context.beginPath(); context.arc(...at(point), radius, 0, 2 * Math.PI); context.fillStyle = colour; context.fill();
      },
    };
  }

  function garage(paint) {
    for (const polygon of data.plan.floors) paint.fill(polygon, COLOURS.floor);
    for (const polygon of data.plan.paint) paint.fill(polygon, COLOURS.paint);
    for (const polygon of data.plan.solid) paint.fill(polygon, COLOURS.solid);
    for (const polygon of data.plan.parked) { paint.fill(polygon, COLOURS.parked); paint.outline(polygon, COLOURS.edge, 1, []); }
  }

  // Small boxes are ringed, or nobody would see them.
  function marks(paint, found, colour, radius, dash) {
    for (const [x, y, length, width, yaw, heeded] of found || []) {
      if (!heeded) paint.outline(corners([x, y, length, width, yaw]), COLOURS.ignored, 1.5, [2, 3]);
      else if (Math.max(length, width) < SMALL_M) paint.ring([x, y], radius, colour, 2, dash);
      else paint.outline(corners([x, y, length + 0.03 * radius, width + 0.03 * radius, yaw]), colour, 2, dash);
    }
  }

  function drawMap({ drive, map }, now) {
    const [context, width, height] = sized(map);
    const ego = drive.ego[now], paint = painter(context, view(ego, width, height));
    garage(paint);
    paint.fill(corners([ego[0], ego[1], ...data.ego_size, ego[2]]), COLOURS.ego);
    const glass = [ego[0] + 0.75 * Math.cos(ego[2]), ego[1] + 0.75 * Math.sin(ego[2])];
    paint.fill(corners([...glass, 0.7, 1.5, ego[2]]), COLOURS.glass);
    for (const user of drive.users) {
      const [x, y, yaw] = user.poses[now];
      paint.fill(corners([x, y, ...user.size, yaw]), COLOURS.truth);
    }
    if (drive.with_roadside) marks(paint, drive.alone[now], COLOURS.alone, 12, [5, 3]);
    marks(paint, drive.found[now], drive.with_roadside ? COLOURS.fused : COLOURS.alone, 8, drive.with_roadside ? [] : [5, 3]);
    context.font = "13px system-ui, sans-serif";
    for (const [number, x, y] of data.plan.units) {
      paint.dot([x, y], 6, COLOURS.unit);
      context.fillStyle = COLOURS.text;
      const [column, row] = paint.at([x, y]), beyond = column > width - 60;
      context.textAlign = beyond ? "right" : "left";
      context.fillText(`RSU ${number}`, column + (beyond ? -9 : 9), row + 4);
      context.textAlign = "left";
    }
    context.fillStyle = COLOURS.text;
    if (!drive.found[now]) context.fillText("perception sleeps: nobody near", 10, 20);
    if (now === drive.speed.length - 1) {
      context.fillStyle = drive.outcome === "none" ? "#3c8c4b" : "#c83232";
      context.fillRect(0, height - 34, width, 34);
      context.fillStyle = "#ffffff";
      context.font = "16px system-ui, sans-serif";
      context.fillText(drive.ending, 12, height - 12);
    }
  }

  function drawSpeeds({ drive, speeds }, now) {
    const [context, width, height] = sized(speeds);
    const top = 1.1 * data.cruising_mps, right = width - 8;
    const x = k => LEFT_PX + (right - LEFT_PX) * k / Math.max(ticks - 1, 1);
    const y = v => height - BOTTOM_PX - (height - BOTTOM_PX - TOP_PX) * v / top;
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = COLOURS.text; context.strokeStyle = COLOURS.grid; context.lineWidth = 1;
    for (let v = 0; v <= top; v += top > 6 ? 2 : 1) {
      context.beginPath(); context.moveTo(LEFT_PX, y(v)); context.lineTo(right, y(v)); context.stroke();
      context.fillText(String(v), 16, y(v) + 4);
    }
    for (let s = 0; s * 1.0001 <= (ticks - 1) * data.tick_s; s += 2) context.fillText(`${s} s`, x(s / data.tick_s) - 6, height - 4);
    const curve = (values, colour, steps, dash) => {
      context.beginPath();
      values.forEach((v, k) => {
        if (k && steps) context.lineTo(x(k), y(values[k - 1]));
        if (k) context.lineTo(x(k), y(v)); else context.moveTo(x(k), y(v));
      });
      context.strokeStyle = colour; context.lineWidth = 1.6; context.setLineDash(dash); context.stroke(); context.setLineDash([]);
    };
    if (drive.target_alone) curve(drive.target_alone, COLOURS.alone, true, [5, 3]);
    curve(drive.target, drive.with_roadside ? COLOURS.fused : COLOURS.alone, true, []);
    curve(drive.speed, COLOURS.ego, false, []);
    let left = LEFT_PX;
    const names = [["speed (m/s)", COLOURS.ego], ["target speed", drive.with_roadside ? COLOURS.fused : COLOURS.alone]];
    if (drive.target_alone) names.push(["by the vehicle alone", COLOURS.alone]);
    for (const [name, colour] of names) {
      context.fillStyle = colour; context.fillText(name, left, 12); left += context.measureText(name).width + 14;
    }
    context.strokeStyle = "#ffd34d"; context.lineWidth = 1.5;
    context.beginPath(); context.moveTo(x(tick), TOP_PX - 4); context.lineTo(x(tick), height - BOTTOM_PX); context.stroke();
    return now;
  }

  function tell({ drive, value }, now) {
    const found = drive.found[now], heeded = (found || []).filter(box => box[5]).length;
    value("speed", `${drive.speed[now].toFixed(2)} m/s`);
    value("target", `${drive.target[now].toFixed(2)} m/s`);
    value("alone", drive.target_alone ? `${drive.target_alone[now].toFixed(2)} m/s` : "\u2013");
    value("heeded", found ? heeded : "asleep");
    value("others", found ? found.length - heeded : "asleep");
    value("bytes", drive.bytes[now] ? `${drive.bytes[now]}, ${Math.round(1000 * drive.age_s[now])} ms` : "\u2013");
  }

  function show(wanted) {
    tick = Math.min(Math.max(Math.round(wanted), 0), ticks - 1);
    slider.value = tick;
    const time = `${(tick * data.tick_s).toFixed(2)} s`;
    document.getElementById("time").textContent = time;
    slider.setAttribute("aria-valuetext", time);
    for (const panel of panels) {
      const now = Math.min(tick, panel.drive.speed.length - 1);
      drawMap(panel, now);
      drawSpeeds(panel, now);
      tell(panel, now);
    }
  }

  function pause() {
    if (playing !== null) cancelAnimationFrame(playing);
    playing = null;
    button.textContent = "Play";
  }

  function play() {
    if (tick >= ticks - 1) show(data.start);
    let last = null, reached = tick;
    const step = stamp => {
      const rate = Number(document.getElementById("rate").value);
      if (last !== null) reached += rate * (stamp - last) / 1000 / data.tick_s;
      last = stamp;
      if (Math.floor(reached) !== tick) show(Math.floor(reached));
      if (tick >= ticks - 1) return pause();
      playing = requestAnimationFrame(step);
    };
    button.textContent = "Pause";
    playing = requestAnimationFrame(step);
  }

  const toggle = () => playing === null ? play() : pause();
  const go = wanted => { pause(); show(wanted); };
  const KEYS = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 };
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
    if (event.key === " " && event.target.type !== "checkbox") toggle();
    else if (event.key in KEYS) go(tick + KEYS[event.key] * (event.shiftKey ? 10 : 1));
    else if (event.key === "Home") go(0);
    else if (event.key === "End") go(ticks - 1);
    else if (event.key.toLowerCase() === "g") document.getElementById("whole").click();
    else return;
    event.preventDefault();
  });
  // The key has been taken above; without this, a button that has the focus would be pressed by it as well.
  document.addEventListener("keyup", event => { if (event.key === " " && event.target === button) event.preventDefault(); });
  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => go(Number(slider.value)));
  document.getElementById("whole").addEventListener("change", () => show(tick));
  window.addEventListener("resize", () => show(tick));
  for (const panel of panels) {
    const seek = event => {
      const share = (event.offsetX - LEFT_PX) / (panel.speeds.clientWidth - 8 - LEFT_PX);
      go(share * (ticks - 1));
    };
    panel.speeds.addEventListener("pointerdown", event => { panel.speeds.setPointerCapture(event.pointerId); seek(event); });
    panel.speeds.addEventListener("pointermove", event => { if (event.buttons) seek(event); });
  }
  slider.max = ticks - 1;
  show(data.start);
})();
