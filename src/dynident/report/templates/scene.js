// An arm in three dimensions that moves along recordings, and the figures over time that follow it: each has a cursor at
// the time that the arm shows, and moves the arm to where it is pointed at.
const Scene = (() => {
  const scenes = [], followers = [];
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)).buffer);
  const pressed = (button) => button.getAttribute("aria-pressed") === "true";
  const STEPS = 500; // of a slider, one for each press of a key
  let shownRun, shownTime = 0;

  // Poses are (3, 4) by rows: a rotation, and beside it where the origin is.
  function after(a, b) {
    const out = new Float64Array(12);
    for (let i = 0; i < 12; i += 4)
      for (let j = 0; j < 4; j++)
        out[i + j] = a[i] * b[j] + a[i + 1] * b[4 + j] + a[i + 2] * b[8 + j] + (j === 3 ? a[i + 3] : 0);
    return out;
  }

  function turned([x, y, z], angle) {
    const c = Math.cos(angle), s = Math.sin(angle), v = 1 - c;
    return [
      c + v * x * x, v * x * y - s * z, v * x * z + s * y, 0,
      v * x * y + s * z, c + v * y * y, v * y * z - s * x, 0,
      v * x * z - s * y, v * y * z + s * x, c + v * z * z, 0,
    ];
  }

  // Where the bodies are, each after its parent, at their positions q.
  function placed(bodies, q) {
    const found = [];
    bodies.parent.forEach((parent, b) => {
      const axis = bodies.axis.subarray(3 * b, 3 * b + 3);
      const [x, y, z] = axis;
      const joint = bodies.slides[b] ? [1, 0, 0, q[b] * x, 0, 1, 0, q[b] * y, 0, 0, 1, q[b] * z] : turned(axis, q[b]);
      const own = after(bodies.placement.subarray(12 * b, 12 * b + 12), joint);
      found.push(parent < 0 ? own : after(found[parent], own));
    });
    return found;
  }

  function moved({ points, body, count }, poses) {
    const out = [0, 1, 2].map(() => new Float32Array(count));
    let k = 0;
    for (const [b, many] of body)
      for (const end = k + many; k < end; k++) {
        const [x, y, z] = points.subarray(3 * k, 3 * k + 3);
        const m = poses[b] ?? [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
        for (let i = 0; i < 3; i++) out[i][k] = m[4 * i] * x + m[4 * i + 1] * y + m[4 * i + 2] * z + m[4 * i + 3];
      }
    return out;
  }

  // Positions at a time, between two that are known.
  function positions(run, bodies, time) {
    const last = run.q.length / bodies - 1;
    const at = Math.min(Math.max(((time - run.start) / (run.stop - run.start)) * last || 0, 0), last);
    const k = Math.min(Math.floor(at), Math.max(last - 1, 0));
    return Array.from({ length: bodies }, (_, b) => {
      const here = run.q[k * bodies + b], next = run.q[Math.min(k + 1, last) * bodies + b];
      return here + (at - k) * (next - here);
    });
  }

  // The newest pose wins where the drawing is slower than what asks for it.
  async function paint(scene) {
    if (scene.busy || !scene.near) return void (scene.late = true);
    scene.busy = true;
    scene.late = false;
    const poses = placed(scene.bodies, positions(scene.run, scene.bodies.parent.length, scene.time));
    const all = scene.moving.flatMap((_, i) => (scene.box.data[i].visible === false ? [] : [i]));
    const points = all.map((i) => moved(scene.moving[i], poses));
    const [x, y, z] = [0, 1, 2].map((axis) => points.map((one) => one[axis]));
    await Plotly.restyle(scene.box, { x, y, z }, all);
    scene.busy = false;
    if (scene.late) paint(scene);
  }

  function tell(scene) {
    if (!scene.player) return;
    const { start, stop } = scene.run, { slider, output } = scene;
    [slider.min, slider.max, slider.step] = [0, STEPS, 1];
    slider.value = Math.round((STEPS * (scene.time - start)) / (stop - start || 1));
    output.value = `${scene.time.toFixed(stop - start < 10 ? 2 : 1)} s`;
    slider.setAttribute("aria-valuetext", scene.run.name ? `${output.value} of ${scene.run.name}` : output.value);
  }

  // All that shows the run: scenes take the pose, figures the cursor.
  function go(name, time) {
    [shownRun, shownTime] = [name, time];
    for (const scene of scenes) {
      const run = scene.runs.find((one) => one.name === name);
      if (!run) continue;
      scene.run = run;
      scene.time = Math.min(Math.max(time, run.start), run.stop);
      tell(scene);
      paint(scene);
    }
    followers.forEach(mark);
  }

  function mark({ box, name, cursor }) {
    const { xaxis, _size: size } = box._fullLayout ?? {};
    const [from, to] = xaxis ? [...xaxis.range].sort((a, b) => a - b) : [1, 0];
    cursor.hidden = name !== shownRun || shownTime < from || shownTime > to;
    if (cursor.hidden) return;
    cursor.style.left = `${xaxis._offset + xaxis.l2p(shownTime)}px`;
    cursor.style.top = `${size.t}px`;
    cursor.style.height = `${size.h}px`;
  }

  // A figure over time that belongs to a run: pointed at, it moves the arm; while that plays, only by a click.
  function follow(box) {
    const name = box.layout.meta?.run;
    if (name === undefined) return;
    const cursor = document.createElement("div");
    cursor.className = "cursor";
    box.append(cursor);
    const one = { box, name, cursor };
    followers.push(one);
    const playing = () => scenes.some((scene) => scene.player && pressed(scene.play));
    box.on("plotly_hover", ({ xvals, points }) => playing() || go(name, xvals?.[0] ?? points[0].x));
    box.on("plotly_click", ({ points }) => go(name, points[0].x));
    box.on("plotly_afterplot", () => mark(one));
    mark(one);
  }

  // A choice among logs is one of a run, too.
  function choose(option) {
    const scene = scenes.find(({ runs }) => runs.some((run) => run.name === option));
    if (scene && shownRun !== option) go(option, shownTime);
  }

  function step(scene, stamp) {
    if (!pressed(scene.play)) return;
    const passed = scene.last ? Math.min((stamp - scene.last) / 1000, 0.2) : 0;
    scene.last = stamp;
    if (!scene.busy) {
      const { start, stop, name } = scene.run;
      go(name, scene.time + passed > stop ? start : scene.time + passed);
    }
    requestAnimationFrame((next) => step(scene, next));
  }

  function layer(scene, button, { shown, faded }) {
    button.setAttribute("aria-pressed", !pressed(button));
    const on = pressed(button);
    Plotly.restyle(scene.box, { visible: on }, shown);
    Plotly.restyle(scene.box, { opacity: on ? 0.16 : 1 }, faded);
    paint(scene);
  }

  function controls(scene, layers) {
    const [play, ...others] = scene.player.querySelectorAll("button");
    Object.assign(scene, { play, slider: scene.player.querySelector("input"), output: scene.player.querySelector("output") });
    play.addEventListener("click", () => {
      play.setAttribute("aria-pressed", !pressed(play));
      scene.last = 0;
      if (pressed(play)) requestAnimationFrame((stamp) => step(scene, stamp));
    });
    others.forEach((button, k) => button.addEventListener("click", () => layer(scene, button, layers[k])));
    scene.slider.addEventListener("input", () => {
      const { name, start, stop } = scene.run;
      go(name, start + (scene.slider.value / STEPS) * (stop - start));
    });
    scene.player.hidden = false;
  }

  // The first traces of a box move: their points stand in the frames of bodies, given as [body, number of points].
  function add(box, { bodies, replays, moving, layers }) {
    const scene = {
      box,
      player: box.parentElement.querySelector(".player"),
      bodies: { ...bodies, placement: floats(bodies.placement), axis: floats(bodies.axis) },
      runs: replays.map((one) => ({ ...one, q: floats(one.q) })),
      moving: moving.map(({ points, body }) => {
        const local = floats(points);
        return { points: local, body, count: local.length / 3 };
      }),
    };
    scene.run = scene.runs.find((one) => one.name === shownRun) ?? scene.runs[0];
    scene.time = Math.min(Math.max(shownTime, scene.run.start), scene.run.stop);
    scenes.push(scene);
    new IntersectionObserver(([{ isIntersecting }]) => {
      scene.near = isIntersecting; // one that nobody sees need not be drawn
      if (scene.near && scene.late) paint(scene);
    }).observe(box);
    return scene;
  }

  function draw(box, motion) {
    const scene = add(box, motion);
    if (scene.player) controls(scene, motion.layers);
    shownRun ??= scene.run.name;
    tell(scene);
    if (scene.time !== scene.run.start || scene.run !== scene.runs[0]) paint(scene);
  }

  const able = (() => {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") ?? canvas.getContext("webgl"));
  })();

  return { able, draw, follow, choose };
})();
