// What the page does by itself: it asks for one thing at a time, paints figures, and keeps their zoom together.
(() => {
  const REST = 180; // ms after which a slider that stands is taken as set
  const PAUSE = 600; // ms without a change after which the whole identification begins
  const LOST = 10000; // ms after which an answer is no longer waited for
  const none = () => window.dash_clientside.no_update;
  const put = (id, props) => window.dash_clientside.set_props(id, props);
  const now = (id) => window.dash_component_api?.getLayout(id)?.props ?? {};
  const ink = () => getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
  const box = (id) => document.querySelector(`#${id} .js-plotly-plot`);
  const config = { responsive: true, displaylogo: false, doubleClick: "reset", modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  const timed = ["motion", "torque"];
  let busy = false, next = null, moved = 0, resting = 0, pausing = 0, zoom = null, zero = 0, leaving = false;

  // ---- asking: one request at a time, and of those that wait the newest; not by Dash, whose way takes longer ---
  async function ask(wanted) {
    if (busy) return void (next = wanted);
    busy = true;
    try {
      const answer = await fetch("curves", {
        method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(wanted), signal: AbortSignal.timeout(LOST),
      });
      await show(await answer.json(), wanted);
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

  // ---- painting -----------------------------------------------------------------------------------------------
  function painted(figure, id) {
    const { data, layout } = figure;
    layout.font = { ...layout.font, color: ink() };
    for (const trace of data.filter((trace) => trace.meta === "ink")) {
      trace.line = { ...trace.line, color: ink() };
      if (trace.marker) trace.marker.color = ink();
    }
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
      put("drawn", { data: { window: range.map((t) => t + zero), at: performance.now() } });
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
    ask(asked(now("address").search ?? "", null));
    put("zoomed", { data: { zoom: zoom && zoom.map((t) => t + zero) } });
  }

  function repaint() {
    for (const gd of document.querySelectorAll(".js-plotly-plot")) {
      if (!gd.data) continue;
      window.Plotly.relayout(gd, { "font.color": ink() });
      const inked = gd.data.flatMap((trace, i) => (trace.meta === "ink" ? [i] : []));
      if (inked.length) window.Plotly.restyle(gd, { "line.color": ink(), "marker.color": ink() }, inked);
    }
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);

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
      reload: (ready) => (ready && location.reload(), none()),

      tab: () => crypto.randomUUID(),

      // The slider moved, or the setting changed: ask for the curves; what rests is set, what pauses is identified.
      moved(degree, search, synced) {
        const by = window.dash_clientside.callback_context.triggered.map((one) => one.prop_id);
        if (by.length === 1 && by[0] === "degree.value") {
          if (degree === null || Math.abs(degree - synced?.degree) < 1e-9) return none();
          moved = performance.now();
          clearTimeout(resting);
          clearTimeout(pausing);
          resting = setTimeout(() => put("slid", { data: degree }), REST);
          ask(asked(search, degree));
          return none();
        }
        clearTimeout(pausing);
        pausing = setTimeout(() => put("rested", { data: { search, at: performance.now() } }), PAUSE);
        ask(asked(search, null));
        return none();
      },

      curve: (data) => (data ? painted(data, "curve") : none()),
      torque(data) {
        if (!data) return none();
        bind("torque", box("torque"));
        return painted(data, "torque");
      },

      // Controls follow the setting, except a slider that is being moved.
      applied(synced) {
        for (const [name, value] of Object.entries(synced?.controls ?? {})) {
          const id = { control: name };
          if (JSON.stringify(now(id).value ?? null) !== JSON.stringify(value)) put(id, { value });
        }
        if (synced && performance.now() - moved > 2 * REST && now("degree").value !== synced.degree)
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
