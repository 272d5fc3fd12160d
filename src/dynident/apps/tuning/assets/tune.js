// What the page does by itself: it asks for one thing at a time, paints figures, and keeps their zoom together.
(() => {
  const REST = 180; // ms after which a slider that stands is taken as set
  const PAUSE = 600; // ms without a change after which the whole identification begins
  const NEAR = 1e-3; // of log S/n: what is no movement of the slider
  const LOST = 10000; // ms after which an answer is no longer waited for
  const none = () => window.dash_clientside.no_update;
  const put = (id, props) => window.dash_clientside.set_props(id, props);
  const now = (id) => window.dash_component_api?.getLayout(id)?.props ?? {};
  const INK = "#111111"; // on white; the styles of the page turn it on dark paper
  const box = (id) => document.querySelector(`#${id} .js-plotly-plot`);
  const config = { responsive: true, displaylogo: false, doubleClick: "reset", modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  const timed = ["motion", "torque"];
  let setting = "", set = NaN, acting = Promise.resolve(), busy = false, next = null, moved = -1e9, resting = 0, pausing = 0, zoom = null, zero = 0, leaving = false;

  async function post(path, content) {
    const how = { method: "POST", headers: { "Content-Type": "application/json" }, signal: AbortSignal.timeout(LOST) };
    return (await fetch(path, { ...how, body: JSON.stringify(content) })).json();
  }

  // ---- asking: one request at a time, and of those that wait the newest; not by Dash, whose way takes longer ---
  async function ask(wanted) {
    if (busy) return void (next = wanted);
    busy = true;
    try {
      await show(await post("curves", wanted), wanted);
    } catch {
      // the next request, or the words on a server that has ended, follow
    }
    busy = false;
    if (!next) return;
    [wanted, next] = [next, null];
    ask(wanted);
  }

  const asked = (search, degree) => ({
    search, degree, tab: now("tab").data, zoom: zoom && zoom.map((t) => t + zero), fine: degree === null, at: performance.now(),
  });

  async function show(data, wanted) {
    put("motion-words", { children: data.words, className: data.wrong ? "wrong" : "muted" });
    if (data.wrong) return;
    if (data.degree) put("degree-words", { children: data.degree });
    if (data.zero !== zero) zoom = null;
    zero = data.zero;
    for (const id of ["motion", "residual"]) {
      if (!data[id]) continue;
      if (!wanted.fine && box(id)?.data?.length === data[id].data.length) await move(box(id), data[id].data);
      else await draw(id, ...Object.values(painted(data[id], id)));
    }
    performance.measure("curves", { start: wanted.at });
  }

  // The curves of a figure move, and nothing else of it: three times as fast.
  const numbers = ({ dtype, bdata }) => {
    const bytes = Uint8Array.from(atob(bdata), (sign) => sign.charCodeAt(0)).buffer;
    return dtype === "f8" ? new Float64Array(bytes) : new Float32Array(bytes);
  };
  const move = (gd, traces) => window.Plotly.restyle(gd, { x: traces.map(({ x }) => numbers(x)), y: traces.map(({ y }) => numbers(y)) });

  async function draw(id, traces, layout) {
    while (!window.Plotly) await new Promise(requestAnimationFrame);
    const place = document.getElementById(id);
    const gd = place.firstElementChild ?? place.appendChild(document.createElement("div"));
    await window.Plotly.react(gd, traces, layout, gd.data ? undefined : config);
    bind(id, gd);
  }

  // ---- acting: one after the other, each on what the one before has made ----------------------------------------
  async function send(control, value) {
    try {
      const answer = await post("act", { search: setting, control, value });
      put("complaint", { children: answer.words });
      if (answer.words || answer.search === setting) return void ask(asked(setting, null));
      setting = answer.search;
      put("address", { search: setting });
    } catch {
      // the words on a server that has ended follow
    }
  }
  // When a person pauses, the whole identification begins: of whatever is set then.
  function pause() {
    clearTimeout(pausing);
    pausing = setTimeout(() => put("rested", { data: { search: setting, at: performance.now() } }), PAUSE);
  }
  const act = (control, value) => (acting = acting.then(() => send(control, value)));

  // ---- painting -----------------------------------------------------------------------------------------------
  function painted(figure, id) {
    const { data, layout } = figure;
    layout.font = { ...layout.font, color: INK };
    if (timed.includes(id)) {
      layout.dragmode = leaving && id === "motion" ? "select" : "zoom";
      if (zoom) for (const axis of Object.keys(layout).filter((key) => key.startsWith("xaxis"))) layout[axis].range = [...zoom];
    }
    if (matchMedia("(pointer: coarse)").matches) layout.dragmode = false; // a finger means to scroll the page
    return { data, layout };
  }

  function bind(id, gd) {
    if (!gd?.on) return void requestAnimationFrame(() => bind(id, box(id)));
    if (gd.bound) return;
    gd.bound = true;
    if (!timed.includes(id)) return;
    gd.on("plotly_relayout", (change) => zoomed(id, change));
    gd.on("plotly_selected", (event) => {
      const range = event?.range && Object.entries(event.range).find(([key]) => key.startsWith("x"))?.[1];
      if (!range) return;
      act("exclude", range.map((t) => Number((t + zero).toFixed(3))));
      window.Plotly.relayout(gd, { selections: [] });
    });
  }

  function zoomed(id, change) {
    const key = Object.keys(change).find((key) => /^xaxis\d*\.(range|autorange)/.test(key));
    if (!key) return;
    const axis = key.split(".")[0];
    const range = change[`${axis}.range`] ?? (`${axis}.range[0]` in change ? [change[`${axis}.range[0]`], change[`${axis}.range[1]`]] : null);
    if (JSON.stringify(range) === JSON.stringify(zoom)) return;
    zoom = range;
    for (const other of timed.filter((one) => one !== id)) {
      const gd = box(other);
      if (!gd?.layout) continue;
      const last = Object.keys(gd.layout).filter((name) => /^xaxis\d*$/.test(name)).pop();
      window.Plotly.relayout(gd, zoom ? { [`${last}.range`]: [...zoom] } : { [`${last}.autorange`]: true });
    }
    ask(asked(setting, null));
    put("zoomed", { data: { zoom: zoom && zoom.map((t) => t + zero) } });
  }

  // ---- the server ---------------------------------------------------------------------------------------------
  let missed = 0;
  setInterval(async () => {
    if (document.hidden || !document.getElementById("tune")) return;
    try {
      await fetch("alive", { cache: "no-store" });
      if (missed > 1) put("gone", { data: false });
      missed = 0;
    } catch {
      if (++missed === 2) put("gone", { data: true });
    }
  }, 3000);

  window.dash_clientside = Object.assign({}, window.dash_clientside, {
    tune: {
      tab: () => crypto.randomUUID(),

      // The slider moved, or the setting changed: ask for the curves; what rests is set, what pauses is identified.
      moved(degree, search) {
        const by = window.dash_clientside.callback_context.triggered.map((one) => one.prop_id);
        if (by.length === 1 && by[0] === "degree.value") {
          if (degree === null || !(Math.abs(degree - set) >= NEAR)) return none();
          set = degree;
          moved = performance.now();
          clearTimeout(resting);
          pause();
          resting = setTimeout(() => act("degree", degree), REST);
          ask(asked(search, degree));
          return none();
        }
        if (by.includes("address.search")) setting = search ?? ""; // also by the browser's own button to go back
        pause();
        ask(asked(setting, null));
        return none();
      },

      curve: (data) => (data ? painted(data, "curve") : none()),
      loop: (data) => (data ? painted(data, "loop") : none()),
      kept(clicks, last) {
        const kept = (last?.kept ?? null) === null ? setting : null;
        return [{ ...last, kept }, String(kept !== null)];
      },
      torque(data) {
        if (!data) return none();
        bind("torque", box("torque"));
        return painted(data, "torque");
      },

      // What was moved is told the server; a control that shows what is set already changes nothing there.
      told(...given) {
        const [from, to] = given.slice(-2);
        for (const { prop_id, value } of window.dash_clientside.callback_context.triggered) {
          const id = prop_id.startsWith("{") ? JSON.parse(prop_id.slice(0, prop_id.lastIndexOf("."))) : {};
          if (id.control) act(id.control, value);
          else if (value && id.button) act(id.button, null);
          else if (value) act("exclude", [from, to]);
        }
        return none();
      },

      // Controls follow the setting, except a slider that is being moved.
      applied(synced) {
        if (!synced) return none();
        for (const [name, value] of Object.entries(synced.controls))
          if ((now({ control: name }).value ?? null) !== value) put({ control: name }, { value });
        for (const button of document.querySelectorAll("button[aria-pressed][id^='{']")) {
          const id = JSON.parse(button.id), pressed = String(synced.pressed.includes(id.button));
          if (button.getAttribute("aria-pressed") !== pressed) put(id, { "aria-pressed": pressed });
        }
        put("keep", { "aria-pressed": String((now("last").data?.kept ?? null) !== null) });
        if (performance.now() - moved < 2 * REST) return none();
        set = synced.degree;
        if (Math.abs(now("degree").value - synced.degree) >= NEAR)
          put("degree", { value: synced.degree });
        return none();
      },

      leaving(clicks, pressed) {
        leaving = pressed !== "true";
        const gd = box("motion");
        if (gd) window.Plotly.relayout(gd, { dragmode: leaving ? "select" : "zoom" });
        return leaving ? "true" : "false";
      },

      gone: (gone) => (gone ? "The server has ended. Type the command again: it prints a new address." : ""),
    },
  });
})();
