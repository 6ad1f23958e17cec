"use strict";
// All state is the daemon's: this page shows what it is sent, and a reload loses nothing. The form's last values are the
// only thing kept in the browser.

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const FORMATS = ["json", "ros", "opencv", "kalibr", "mrcal", "colmap"];
const OF_ONE_SENSOR = ["ros", "opencv", "mrcal"];
const REASONS = {
  no_corners: "no board", no_grid: "no grid", no_lattice: "no grid", no_markers: "no markers", other_size: "wrong board size",
  other_board: "another board", low_contrast: "too little contrast", image_too_small: "image too small", cut_off: "cut off",
  incomplete: "occluded", partial: "partly visible", two_places: "position ambiguous", mirrored: "mirrored image", blurred: "blurred",
  moving: "moving", too_similar: "nothing new", unreadable: "unreadable", no_image: "no color image",
  other_image_size: "wrong image size", no_texture: "too little texture", unknown_scene: "scene not recognized", full: "session full",
};
const VERDICTS = { good: "Good: use it", usable: "Usable, with care", poor: "Poor: do not use it" };

let camera = null;      // the newest camera document; for a rig, what its document has in common with one
let rig = null;         // the rig document, where a rig is shown
let session = null;     // the session that is shown
let result = null;      // the calibration that is shown
let views = [];         // the views of the session that is shown
let heldBy = null;      // the id of the rig's session that the camera is in
let events = null;
let flashTimer = 0;
let viewsOf = null;
let audio = null;

async function ask(path, options) {
  const response = await fetch(path, options);
  const type = response.headers.get("content-type") || "";
  const body = type.includes("json") ? await response.json() : null;
  if (!response.ok) throw new Error((body && body.detail) || `${response.status} ${response.statusText}`);
  return body;
}
const at = (strings, ...values) => String.raw({ raw: strings }, ...values.map(encodeURIComponent));
const show = (id, on) => { $(id).hidden = !on; };
const px = (value) => (value == null ? "–" : `${value.toFixed(value < 0.1 ? 3 : value < 10 ? 2 : 0)} px`);
const when = (text) => new Date(text).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

function say(id, text, tone) {
  const place = $(id);
  if (place.textContent !== (text || "")) place.textContent = text || "";
  if (tone !== undefined) place.className = tone;
  place.hidden = !text;
}

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value; else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

function drawn(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

// ---- the camera, or the rig, and its image

const home = () => (rig ? at`/v1/rigs/${rig.name}` : at`/v1/cameras/${camera.name}`);
const later = (act) => setTimeout(() => { act().catch(() => later(act)); }, 2000);
// Until the daemon has said what there is, nothing is shown that could be taken for it.
function wait(text, held = null) {
  heldBy = held;
  for (const id of ["start-form", "session", "result", "kept", "past"]) show(id, false);
  say("loading", text);
}

async function begin() {
  let [cameras, rigs] = [[], []];
  wait("Loading the session…");
  try {
    [{ cameras }, { rigs }] = await Promise.all([ask("/v1/cameras"), ask("/v1/rigs")]);
  } catch (error) {
    say("placeholder", `The daemon does not answer: ${error.message}`);
    setTimeout(begin, 2000);
    return;
  }
  if (!cameras.length) {
    say("placeholder", "No camera is configured. Add a [[camera]] to the configuration and start again.");
    say("loading", "");
    return;
  }
  const wanted = decodeURIComponent(location.hash.slice(1));
  const named = (list) => list.find((one) => one.name === wanted);
  const busy = (list) => list.find((one) => one.session);
  rig = named(rigs) || (!named(cameras) && busy(rigs)) || null;
  camera = rig ? ofRig(cameras) : named(cameras) || busy(cameras) || cameras[0];
  $("cameras").replaceChildren(...[...cameras, ...rigs].map((one) => {
    const text = one.cameras ? `${one.name} (${one.cameras.length} cameras)` : one.name;
    const link = element("a", { href: at`#${one.name}` }, text);
    if (one.name === camera.name) link.setAttribute("aria-current", "page");
    return link;
  }));
  say("start-title", rig ? `Calibrate the rig of ${rig.cameras.join(", ")}` : "Calibrate");
  listSensors();
  showCamera();
  showLiveImage();
  follow();
  await showNewest().catch(() => later(showNewest));
}

// What is shown of a rig in a camera's place: streaming while all its cameras are.
function ofRig(cameras) {
  const own = cameras.filter((one) => rig.cameras.includes(one.name));
  const bad = own.find((one) => one.state !== "streaming");
  const slowest = Math.min(...own.map((one) => one.fps || 0));
  return {
    name: rig.name, backend: `rig of ${rig.cameras.join(", ")}`, state: bad ? bad.state : "streaming", sensors: {}, fps: slowest,
    reason: bad && bad.reason ? `${bad.name}: ${bad.reason}` : null, dropped_frames: 0, calibration: rig.calibration, session: rig.session,
  };
}

// A camera with depth can be shown in several ways.
function listSensors() {
  const names = Object.keys(camera.sensors);
  const choices = names.map((name) => [name, name]);
  if (names.includes("depth") && names.includes("color") && camera.calibration) {
    choices.push(["depth&registered=color", "depth edges over color"], ["color&registered=depth", "color as depth sees it"]);
  }
  const select = $("sensor");
  const shown = select.value;
  if (choices.length !== select.options.length) {
    select.replaceChildren(...choices.map(([value, text]) => element("option", { value }, text)));
    if (choices.some(([value]) => value === shown)) select.value = shown;
  }
  show("sensors", choices.length > 1);
}

async function showNewest() {
  const { sessions } = await ask(at`/v1/sessions?camera=${camera.name}`);
  // The list of a camera has the sessions of its rigs too.
  const own = sessions.filter((one) => one.camera === camera.name);
  await setSession(own[0] || null);
  say("loading", "");
  await showHistory();
  if (!rig && camera.session && !own.some((one) => one.id === camera.session)) {
    const held = await ask(at`/v1/sessions/${camera.session}`);
    wait(`This camera is in a session of the rig ${held.camera}: select the rig above to follow it.`, held.id);
  }
}

function showCamera() {
  const sensor = camera.sensors.color || Object.values(camera.sensors)[0];
  const good = camera.state === "streaming";
  say("state", camera.state, `pill ${good ? "good" : camera.state === "failed" ? "poor" : "usable"}`);
  const size = sensor ? `${sensor.image_size[0]} × ${sensor.image_size[1]}` : "";
  const rate = camera.fps ? `${camera.fps.toFixed(1)} fps` : "";
  const dropped = camera.dropped_frames ? `${camera.dropped_frames} dropped` : "";
  say("figures", [camera.backend, size, rate, dropped].filter(Boolean).join(" · "));
  say("camera-reason", camera.reason);
  if (heldBy && camera.session !== heldBy) {
    heldBy = null;
    showNewest().catch(() => later(showNewest));
  }
  if (sensor) $("overlay").setAttribute("viewBox", `-0.5 -0.5 ${sensor.image_size[0]} ${sensor.image_size[1]}`);
}

// The corners are drawn by the daemon, into the very frame that they were found in.
function showLiveImage() {
  const image = $("live-image");
  const corners = $("show-corners").checked;
  show("live-image", !rig);
  show("overlay", !rig);
  show("tiles", Boolean(rig));
  if (rig) {
    image.removeAttribute("src");
    show("placeholder", false);
    $("tiles").replaceChildren(...rig.cameras.map((name) => element("figure", {}, tile(name, corners), element("figcaption", {}, name))));
    return;
  }
  const sensor = $("sensor").value || "color";
  const edges = sensor.includes("&") || corners;
  const source = () => at`/v1/cameras/${camera.name}/preview.mjpg?overlay=${edges}&guidance=false&at=${Date.now()}` + `&sensor=${sensor}`;
  image.alt = `live image of camera ${camera.name}`;
  image.onload = () => show("placeholder", false);
  image.onerror = () => {
    say("placeholder", "no image at the moment");
    setTimeout(() => { image.src = source(); }, 1500);
  };
  image.src = source();
}

// One image after the other: a browser keeps few connections to one place, and endless ones would take them all.
function tile(name, corners) {
  const image = element("img", { alt: `live image of camera ${name}` });
  const next = () => {
    if (image.parentNode && !image.isConnected) return;
    image.src = at`/v1/cameras/${name}/frame.jpg?overlay=${corners}&guidance=false&at=${Date.now()}`;
  };
  image.onload = () => setTimeout(next, 150);
  image.onerror = () => setTimeout(next, 1000);
  next();
  return image;
}

function layer(name) {
  let group = $("overlay").querySelector(`g.${name}s`);
  if (!group) $("overlay").append(group = drawn("g", { class: `${name}s` }));
  return group;
}

function showCoverage() {
  const group = layer("cell");
  const collecting = session && session.state === "collecting";
  if (!$("show-coverage").checked || !collecting || rig) { group.replaceChildren(); return; }
  const { x, y, width, height } = $("overlay").viewBox.baseVal;
  const cells = session.coverage.cells;
  const [high, wide] = [height / cells.length, width / cells[0].length];
  const parts = [];
  cells.forEach((row, i) => row.forEach((count, j) => {
    const place = { x: x + j * wide, y: y + i * high, width: wide, height: high };
    parts.push(drawn("rect", { class: "grid", ...place }));
    if (count) parts.push(drawn("rect", { class: "cell", "fill-opacity": Math.min(0.06 + count / 400, 0.28), ...place }));
  }));
  group.replaceChildren(...parts);
}

// ---- the ghost: the board as it is asked for, in perspective; it glides to its next place

let ghost = null;       // its four outer corners now, in pixels
let ghostFrame = 0;

function showGhost() {
  const outline = session && session.state === "collecting" ? session.guidance.outline_px : [];
  cancelAnimationFrame(ghostFrame);
  if (outline.length !== 4) { ghost = null; layer("ghost").replaceChildren(); return; }
  const [from, began] = [ghost || outline, performance.now()];
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const moves = from.some((p, k) => Math.hypot(p[0] - outline[k][0], p[1] - outline[k][1]) > 0.5);
  const glide = (now) => {
    const part = still || !moves ? 1 : Math.min(1, (now - began) / 500);
    const eased = part * part * (3 - 2 * part);
    ghost = from.map((p, k) => [p[0] + (outline[k][0] - p[0]) * eased, p[1] + (outline[k][1] - p[1]) * eased]);
    drawGhost();
    if (part < 1) ghostFrame = requestAnimationFrame(glide);
  };
  glide(began);
}

// The homography of the unit square (0,0), (1,0), (1,1), (0,1) to four points (Heckbert 1989).
function ofSquare([p0, p1, p2, p3]) {
  const [ax, ay, bx, by] = [p1[0] - p2[0], p1[1] - p2[1], p3[0] - p2[0], p3[1] - p2[1]];
  const [sx, sy] = [p0[0] - p1[0] + p2[0] - p3[0], p0[1] - p1[1] + p2[1] - p3[1]];
  const area = ax * by - ay * bx;
  const [g, h] = [(sx * by - sy * bx) / area, (ax * sy - ay * sx) / area];
  return (u, v) => {
    const w = g * u + h * v + 1;
    const along = (k) => ((p1[k] - p0[k] + g * p1[k]) * u + (p3[k] - p0[k] + h * p3[k]) * v + p0[k]) / w;
    return [along(0), along(1)];
  };
}

// Squares between the outer corners, each way.
function spans({ kind, cols, rows }) {
  return [cols, rows].map((n) => (kind === "charuco" ? n - 2 : kind === "aprilgrid" ? 2 * n - 1 : n - 1));
}

// One path for the dark squares, the outer ones too, and one for the card.
function drawGhost() {
  const group = layer("ghost");
  if (!group.children.length) group.append(drawn("path", { class: "card" }), drawn("path", { class: "dark" }), drawn("path", { class: "top" }));
  const [cols, rows] = spans(session.target);
  const place = ofSquare(ghost);
  const path = (corners) => `M${corners.map(([i, j]) => place(i / cols, j / rows).map((v) => v.toFixed(1)).join()).join("L")}Z`;
  const dark = [];
  for (let j = -1; j <= rows; j += 1) {
    for (let i = -1; i <= cols; i += 1) {
      if ((i + j) % 2 === 0) dark.push(path([[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]]));
    }
  }
  const [card, squares, top] = group.children;
  card.setAttribute("d", path([[-1.4, -1.4], [cols + 1.4, -1.4], [cols + 1.4, rows + 1.4], [-1.4, rows + 1.4]]));
  squares.setAttribute("d", dark.join(""));
  top.setAttribute("d", path([[0, 0], [cols, 0], [cols, rows], [0, rows]]));
}

// How near the board is to its ghost, as a part of the ghost's size: it becomes green, and beeps come faster.
let lastNear = 0;
function showNearness(outline) {
  const group = layer("ghost");
  if (!ghost || !outline || outline.length !== 4) { group.classList.remove("near"); return; }
  const size = Math.hypot(ghost[2][0] - ghost[0][0], ghost[2][1] - ghost[0][1]);
  const off = (start) => ghost.reduce((sum, p, k) => {
    const q = outline[(k + start) % 4];
    return sum + Math.hypot(p[0] - q[0], p[1] - q[1]);
  }, 0) / (4 * size);
  const away = Math.min(off(0), off(2));
  group.classList.toggle("near", away < 0.12);
  const wait = 150 + 1500 * Math.min(1, away);
  if (away < 0.5 && performance.now() - lastNear > wait) { lastNear = performance.now(); beep(520, 0.05); }
}

// ---- the voice: who holds a board watches it and not a screen

let spoken = "";
function speak(text) {
  if (!$("voice").checked || !window.speechSynthesis || !text || text === spoken) return;
  speechSynthesis.cancel();
  const said = new SpeechSynthesisUtterance(text);
  said.lang = "en";
  speechSynthesis.speak(said);
  spoken = text;
}

// ---- what happens

function follow() {
  if (events) events.close();
  events = new EventSource(rig ? "/v1/events" : at`/v1/events?camera=${camera.name}`);
  const mine = (name) => name === camera.name || Boolean(rig && rig.cameras.includes(name));
  events.onopen = () => { if (!$("link").hidden) { show("link", false); refresh(); } };
  events.onerror = () => show("link", true);
  const on = (name, act) => events.addEventListener(name, (event) => act(JSON.parse(event.data)));
  on("camera", (document) => {
    if (!mine(document.name)) return;
    if (rig) refreshCamera().catch(() => {}); else { camera = document; showCamera(); }
  });
  on("detection", showLast);
  on("session", (document) => {
    if (document.camera === camera.name && (!session || document.id >= session.id)) setSession(document);
  });
  on("calibration", (document) => { if (document.camera === camera.name) refreshCamera().then(showHistory); });
}

async function refresh() {
  await refreshCamera();
  await showNewest();
  showLiveImage();
}

async function refreshCamera() {
  if (rig) {
    const [document, { cameras }] = await Promise.all([ask(home()), ask("/v1/cameras")]);
    rig = document;
    camera = ofRig(cameras);
  } else {
    camera = await ask(home());
  }
  showCamera();
  listSensors();
  showApproval();
}

// The outer corners of a whole board, whose corners come row by row, in the ghost's order.
function outerCorners(corners) {
  if (!session || !corners || session.target.kind === "scene") return null;
  const [cols, rows] = spans(session.target).map((n) => n + 1);
  if (corners.length !== cols * rows) return null;
  return [0, cols - 1, cols * rows - 1, cols * (rows - 1)].map((k) => corners[k]);
}

function showLast(detection) {
  showNearness(outerCorners(detection.corners));
  if (!session || detection.session !== session.id || session.state !== "collecting") return;
  if (detection.kept_view != null) {
    const of = rig ? `${detection.camera}: ` : "";
    say("last", `${of}${rig ? "view" : "View"} ${detection.kept_view + 1} kept.`, "last kept");
    flash(`${of}view ${detection.kept_view + 1} kept`);
    beep();
    spoken = "";
  } else {
    const text = detection.reason || REASONS[detection.rejection] || "";
    say("last", text && `${rig ? `${detection.camera}: not` : "Not"} kept: ${text}`, "last refused");
  }
  $("last").hidden = false;
}

function flash(text) {
  say("flash", text);
  $("stage").classList.add("kept");
  clearTimeout(flashTimer);
  flashTimer = setTimeout(() => { show("flash", false); $("stage").classList.remove("kept"); }, 700);
}

function beep(pitch = 880, volume = 0.15) {
  if (!$("sound").checked) return;
  audio = audio || new AudioContext();
  const [tone, level] = [audio.createOscillator(), audio.createGain()];
  tone.frequency.value = pitch;
  level.gain.setValueAtTime(volume, audio.currentTime);
  level.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + 0.18);
  tone.connect(level).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.18);
}

// ---- the session

async function setSession(document) {
  const before = session;
  session = document;
  const running = session && (session.state === "collecting" || session.state === "solving");
  show("start-form", !running && !(session && session.state === "finished"));
  show("session", Boolean(running || (session && session.state === "failed")));
  showCoverage();
  showGhost();
  const message = running && session.state === "collecting" ? session.guidance.message : "";
  say("guidance", message);
  speak(message);
  if (!running) say("last", "");
  if (session) showNumbers(running);
  if (!session || session.state !== "finished") { result = null; show("result", false); }
  const changed = !before || !session || before.id !== session.id || before.state !== session.state;
  if (session && (changed || before.views_kept !== session.views_kept)) showViews();
  if (!session) show("kept", false);
  if (session && session.state === "finished" && (changed || !result)) await showResult(session.calibration);
}

function showNumbers(running) {
  const titles = { collecting: "Collecting", solving: "Solving…", failed: "No calibration", aborted: "Aborted", finished: "Done" };
  say("session-title", titles[session.state]);
  const estimate = session.estimate;
  const set = (id, text) => { if ($(id).textContent !== text) $(id).textContent = text; };
  set("n-views", String(session.views_kept));
  set("n-coverage", `${Math.round(session.coverage.fraction * 100)} %`);
  set("n-rms", px(estimate && estimate.rms_px));
  set("n-uncertainty", px(estimate && estimate.uncertainty_px.median));
  say("session-reason", session.reason);
  $("session-reason").classList.toggle("error", session.state === "failed");
  const counts = Object.entries(session.rejected).filter(([, count]) => count);
  $("rejected").replaceChildren(...counts.map(([kind, count]) => element("li", {}, `${REASONS[kind] || kind} ${count}`)));
  const members = session.cameras || [];
  show("members", members.length > 0);
  fill("members", members.map((one) => [one.camera, one.views_kept, one.views_shared, `${Math.round(one.coverage.fraction * 100)} %`,
    px(one.estimate && one.estimate.uncertainty_px.median)]));
  showGoal(estimate);
  showLiveHeat(running && estimate);
  show("stop", running);
  show("abort", running);
  $("stop").disabled = session.state === "solving";
  $("abort").disabled = session.state === "solving";
  showClock();
}

// The map of what is known so far, drawn anew with each estimate; the old one stays until then.
function showLiveHeat(estimate) {
  const known = estimate && Number.isFinite(estimate.uncertainty_px.median);
  if (!known) { show("live-heat-part", false); $("live-heat").removeAttribute("src"); return; }
  const address = at`/v1/sessions/${session.id}/uncertainty.png?of=${`${estimate.views}-${estimate.uncertainty_px.median}`}`;
  if ($("live-heat").getAttribute("src") === address) return;
  const image = new Image();
  image.onload = () => { $("live-heat").src = address; show("live-heat-part", true); };
  image.src = address;
}

function showGoal(estimate) {
  const goal = session.finish && session.finish.uncertainty_px;
  show("goal-bar", Boolean(goal));
  if (!goal) return;
  const now = estimate && estimate.uncertainty_px.median;
  // From 10 px to the goal, in equal steps of the ratio.
  const part = now ? 1 - Math.log(Math.max(now / goal, 1)) / Math.log(Math.max(10 / goal, 2)) : 0;
  $("progress").value = Math.min(1, Math.max(0, part));
  const least = session.finish.min_views ? `, at least ${session.finish.min_views} views` : "";
  $("goal-text").textContent = `goal: uncertainty below ${goal} px${least}${toGo()}`;
}

// How many views are still needed, and about how long that takes at the pace so far.
function toGo() {
  const range = session.guidance.views_to_go;
  if (!range || session.state !== "collecting") return "";
  const [few, many] = range;
  if (few > 500) return " · not reachable with this board and these images";
  const views = few === many ? `${few}` : `${few} to ${Math.min(many, 999)}`;
  const seconds = (Date.now() - new Date(session.started_at)) / 1000;
  const each = session.views_kept > 2 ? seconds / session.views_kept : 0;
  const minutes = (each * (few + Math.min(many, 999))) / 120;
  const time = each ? `, about ${minutes < 1 ? "a minute" : `${Math.ceil(minutes)} minutes`}` : "";
  return ` · ${views} more view${many === 1 ? "" : "s"}${time}`;
}

function targetInWords({ kind, cols, rows, square_m, tag_m }) {
  return kind === "scene" ? "without a board" : `${cols}×${rows}, ${+((square_m ?? tag_m) * 1000).toFixed(3)} mm`;
}

function showClock() {
  if (!session) return;
  const end = session.finished_at ? new Date(session.finished_at) : new Date();
  const seconds = Math.max(0, Math.round((end - new Date(session.started_at)) / 1000));
  $("clock").textContent = `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")} · ${targetInWords(session.target)}`;
}

async function showViews() {
  const id = session.id;
  const found = (await ask(at`/v1/sessions/${id}/views`)).views;
  if (!session || session.id !== id) return;
  views = found;
  show("kept", views.length > 0);
  const list = $("views");
  if (viewsOf !== id) { list.replaceChildren(); viewsOf = id; }
  views.forEach((view, i) => {
    const item = list.children[i] || list.appendChild(viewItem(view, i));
    const button = item.firstChild;
    const said = view.used === false ? "not used" : view.rms_px == null ? "" : px(view.rms_px);
    button.className = view.used === false ? "unused" : "";
    button.lastChild.lastChild.textContent = said;
    button.setAttribute("aria-label", `view ${view.n + 1}, ${view.name}${said && `, ${said}`}`);
  });
}

function viewItem(view, i) {
  const image = element("img", { src: view.picture, alt: "", loading: "lazy" });
  const words = element("span", {}, element("b", {}, `${view.camera ? `${view.camera} ` : ""}${view.n + 1}`), element("i", {}));
  return element("li", {}, element("button", { type: "button", onclick: () => showLarge(i) }, image, words));
}

function showLarge(i) {
  const view = views[i];
  const [image, words] = $("large").children;
  image.src = view.picture;
  image.alt = `view ${view.n + 1}`;
  const fit = view.rms_px == null ? "" : `, rms ${px(view.rms_px)}`;
  words.textContent = `View ${view.n + 1}: ${view.name}, ${view.corners} corners${fit}${view.reason ? `. Not used: ${view.reason}` : ""}`;
  $("large").showModal();
}

// ---- the result

const fill = (id, rows) => $(id).querySelector("tbody").replaceChildren(...rows.map((row) =>
  element("tr", {}, ...row.map((cell) => element("td", {}, String(cell))))));

// The image sensors of a calibration by name: a camera's own, or a rig's cameras.
function imageSensorsOf(calibration) {
  const own = ["color", "infrared", "infrared2"].filter((name) => calibration.sensors[name]).map((name) => [name, calibration.sensors[name]]);
  return new Map([...own, ...(calibration.cameras || []).map((one) => [one.name, one.sensors.color])]);
}

// Neither a session that is over nor a result is on the page: one can begin again at once.
function showNoResult(why) {
  result = null;
  show("result", false);
  show("start-form", true);
  say("start-error", why);
}

async function showResult(id) {
  if (session && session.calibration === id && session.calibration_deleted) {
    showNoResult("This calibration was deleted. Start a new session, or select an earlier calibration.");
    return;
  }
  try {
    result = await ask(at`/v1/calibrations/${id}`);
  } catch (error) {
    showNoResult(error.message);
    return;
  }
  say("start-error", "");
  const imageSensors = imageSensorsOf(result);
  const { grade, reasons } = result.verdict;
  say("verdict", VERDICTS[grade], "");
  $("verdict").dataset.grade = grade;
  $("verdict").style.color = `var(--${grade})`;
  $("reasons").replaceChildren(...reasons.map((reason) => element("li", {}, reason)));
  $("result-sensor").replaceChildren(...[...imageSensors.keys()].map((name) => element("option", { value: name }, name)));
  show("result-sensors", imageSensors.size > 1);
  if (imageSensors.size) showSensor();
  showPlaces(result.extrinsics || []);
  showDepth(result.sensors.depth);
  const links = [...FORMATS, ...(result.extrinsics && result.extrinsics.length ? ["urdf", "tf"] : []), ...(result.sensors.depth ? ["depth"] : [])];
  const names = [...imageSensors.keys(), ...(result.sensors.depth ? ["depth"] : [])];
  $("downloads").replaceChildren(...links.flatMap((format) => {
    const several = OF_ONE_SENSOR.includes(format) && names.length > 1;
    return (several ? names : [null]).map((name) => element("a", {
      href: at`/v1/calibrations/${id}?format=${format}` + (name ? at`&sensor=${name}` : ""), download: format === "json" ? `${result.camera}.json` : "",
    }, name ? `${format}: ${name}` : format));
  }));
  say("result-error", "");
  show("result", true);
  showApproval();
}

function showSensor() {
  const name = $("result-sensor").value;
  const sensor = imageSensorsOf(result).get(name);
  say("result-what", `${when(result.created_at)} · ${sensor.image_size.join(" × ")} · ${sensor.views.filter((view) => view.used).length} of ${sensor.views.length} views`);
  const numbers = [
    ["rms", px(sensor.rms_px)], ["uncertainty", px(sensor.uncertainty_px.median)], ["worst", px(sensor.uncertainty_px.worst)],
    ["held out", px(result.checks.held_out_rms_px)], ["coverage", `${Math.round(result.checks.coverage * 100)} %`],
    ["lens", sensor.lens.model],
  ];
  $("result-numbers").replaceChildren(...numbers.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
  $("heat").src = at`/v1/calibrations/${result.id}/uncertainty.png?sensor=${name}`;
  const rows = Object.entries(sensor.lens).filter(([name]) => name !== "model").map(([name, value]) =>
    element("tr", {}, element("td", {}, name), element("td", {}, value.toFixed(6)), element("td", {}, sensor.lens_std[name] ? sensor.lens_std[name].toPrecision(2) : "fixed")));
  $("lens-table").tBodies[0].replaceChildren(...rows);
}

function showPlaces(extrinsics) {
  show("places", extrinsics.length > 0);
  const mm = (values, digits) => values.map((value) => (1000 * value).toFixed(digits)).join(", ");
  const degrees = (radians, digits) => (radians * 180 / Math.PI).toFixed(digits);
  $("places").querySelector("dl").replaceChildren(...extrinsics.flatMap((one) => [
    element("dt", {}, one.name),
    element("dd", {}, `${mm(one.translation, 2)} mm (± ${mm(one.translation_std, 3)})`),
    element("dd", {}, `rotated by ${degrees(2 * Math.acos(Math.min(1, one.rotation.w)), 3)}° (± ${degrees(Math.max(...one.rotation_std), 4)}°)`),
  ]));
}

function showDepth(depth) {
  show("depth", Boolean(depth));
  if (!depth) return;
  const corrected = depth.correction ? "Corrected; the errors below are cross-validated." : "The device's own depth is as good, so no correction is applied.";
  const noise = (z) => (1000 * (depth.noise_m.constant + depth.noise_m.quadratic * z * z)).toFixed(1);
  say("depth-what", `${corrected} Noise of a single reading: ${noise(1)} mm at 1 m, ${noise(2)} mm at 2 m.`);
  fill("depth", depth.bias_m.ranges.map((range) => [`${range.from.toFixed(2)} to ${range.to.toFixed(2)}`,
    (1000 * range.before).toFixed(1), (1000 * range.after).toFixed(1), (1000 * range.rms_after).toFixed(1)]));
}

function showApproval() {
  const current = Boolean(result && camera.calibration === result.id);
  show("current", current);
  show("approve", Boolean(result) && !current);
  $("approve").className = result && result.verdict.grade === "poor" ? "" : "primary";
}

async function showHistory() {
  const { calibrations } = await ask(`${home()}/calibrations`);
  show("past", calibrations.length > 0);
  $("history").tBodies[0].replaceChildren(...calibrations.map((one) => {
    const [sensor] = imageSensorsOf(one).values();
    const grade = element("span", { className: `pill ${one.verdict.grade}` }, one.verdict.grade);
    const current = one.id === camera.calibration ? element("span", { className: "pill good" }, "current") : "";
    const open = element("button", { className: "small", type: "button", onclick: () => openResult(one) }, "show");
    return element("tr", {}, element("td", {}, when(one.created_at)), element("td", {}, grade, " ", current),
      element("td", {}, sensor ? sensor.lens.model : "–"), element("td", {}, px(sensor && sensor.rms_px)),
      element("td", {}, px(sensor && sensor.uncertainty_px.median)), element("td", {}, open));
  }));
}

async function openResult(calibration) {
  if (session && (session.state === "collecting" || session.state === "solving")) {
    location.assign(at`/v1/calibrations/${calibration.id}`);
    return;
  }
  if (calibration.session) await setSession(await ask(at`/v1/sessions/${calibration.session}`));
  await showResult(calibration.id);
  $("panel").focus();
}

// ---- what the person does

async function press(button, errorPlace, act) {
  button.disabled = true;
  say(errorPlace, "");
  try {
    await act();
  } catch (error) {
    say(errorPlace, error.message);
  } finally {
    button.disabled = false;
  }
}

// What is counted and measured on each kind of board.
const KINDS = {
  chessboard: ["Corners in a row", "Square, mm", "Count the inner corners, where four squares meet, and measure one square: measuring across many squares and dividing is more accurate."],
  charuco: ["Squares in a row", "Square, mm", "Count the squares, black and white, and measure one square and one marker: measuring across many squares and dividing is more accurate."],
  scene: ["", "", "There is nothing to count or measure: move the camera around a static scene with texture, mainly sideways, and roll it by 90 degrees from time to time."],
  aprilgrid: ["Tags in a row", "Tag, mm", "Count the tags, and measure a tag with its black border, and the gap between two tags, divided by the tag size."],
};
const KIND_FIELDS = ["marker", "dictionary", "spacing", "family", "first_id"];

function showKind() {
  const kind = $("kind").value;
  [$("cols-title").textContent, $("square-title").textContent, $("how-to-count").textContent] = KINDS[kind];
  for (const label of document.querySelectorAll("#start-form [data-kind]")) {
    const has = label.dataset.kind.split(" ").includes(kind);
    label.hidden = !has;
    label.querySelector("input").disabled = !has;
  }
}
$("kind").addEventListener("change", showKind);

function targetOf(form) {
  if (form.kind === "scene") return { kind: form.kind };
  const size = { kind: form.kind, cols: +form.cols, rows: +form.rows };
  const side = +form.square / 1000;
  if (form.kind === "charuco") {
    return { ...size, square_m: side, marker_m: +form.marker / 1000, dictionary: form.dictionary, first_id: +form.first_id };
  }
  if (form.kind === "aprilgrid") {
    return { ...size, tag_m: side, spacing: +form.spacing, family: form.family, first_id: +form.first_id };
  }
  return { ...size, square_m: side };
}

// Fills in what an image shows of a board; lengths are measured.
function fillTarget(target) {
  $("kind").value = target.kind;
  showKind();
  for (const id of ["cols", "rows", "dictionary", "spacing", "family", "first_id"]) if (id in target) $(id).value = target[id];
  if (target.marker_ratio && $("square").value) $("marker").value = +(target.marker_ratio * $("square").value).toFixed(2);
  $("square").focus();
}

$("detect-target").addEventListener("click", () => press($("detect-target"), "start-error", async () => {
  say("seen-target", "Searching…");
  try {
    const seen = await ask(at`/v1/cameras/${rig ? rig.cameras[0] : camera.name}/target`);
    say("seen-target", seen.found ? `${seen.name}. Measure its lengths and enter them below.` : seen.reason);
    if (seen.found) fillTarget(seen.target);
  } catch (error) {
    say("seen-target", "");
    throw error;
  }
}));

$("start-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const form = { kind: $("kind").value, cols: $("cols").value, rows: $("rows").value, square: $("square").value, lens: $("lens").value, finish: $("finish").checked, goal: $("goal").value };
  for (const id of KIND_FIELDS) form[id] = $(id).value;
  localStorage.setItem("plumb", JSON.stringify(form));
  const body = { target: targetOf(form), lens: form.lens };
  if (form.finish) body.finish = { uncertainty_px: +form.goal, min_views: 10 };
  press($("start"), "start-error", async () => {
    const started = await ask(`${home()}/sessions`, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
    });
    await setSession(started);
    $("stop").focus();
  });
});

$("stop").addEventListener("click", () => press($("stop"), "session-error", async () => {
  await setSession(await ask(at`/v1/sessions/${session.id}/stop?wait=false`, { method: "POST" }));
}));
$("abort").addEventListener("click", () => press($("abort"), "session-error", async () => {
  await setSession(await ask(at`/v1/sessions/${session.id}`, { method: "DELETE" }));
}));
$("approve").addEventListener("click", () => press($("approve"), "result-error", async () => {
  await ask(at`/v1/calibrations/${result.id}/approve`, { method: "POST" });
  await refreshCamera();
  await showHistory();
}));
$("again").addEventListener("click", () => {
  show("result", false);
  show("start-form", true);
  $("cols").focus();
});
$("show-coverage").addEventListener("change", showCoverage);
$("show-corners").addEventListener("change", showLiveImage);
$("sensor").addEventListener("change", showLiveImage);
$("result-sensor").addEventListener("change", showSensor);
window.addEventListener("hashchange", () => { session = null; result = null; viewsOf = null; begin(); });
setInterval(() => { if (session && session.state === "collecting") showClock(); }, 1000);
setInterval(() => { if (camera && !document.hidden) refreshCamera().catch(() => {}); }, 5000);

try {
  const form = JSON.parse(localStorage.getItem("plumb")) || {};
  for (const id of ["kind", "cols", "rows", "square", "lens", "goal", ...KIND_FIELDS]) if (form[id]) $(id).value = form[id];
  showKind();
  $("finish").checked = Boolean(form.finish);
} catch { /* nothing kept */ }
begin();
