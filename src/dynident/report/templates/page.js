// Figures are drawn when they come near the window, in ink on white; the styles of the page turn them on dark paper.
(() => {
  const boxes = [...document.querySelectorAll(".plot")];
  // Plotly is packed in the page; inflated, it runs as a script of the page.
  const plotly = (async () => {
    const packed = document.getElementById("plotly");
    const bytes = Uint8Array.from(atob(packed.textContent), (sign) => sign.charCodeAt(0));
    const script = document.createElement("script");
    script.textContent = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
    packed.replaceWith(script);
  })();
  const [GREY, INK] = ["#7d7d7d", "#111111"]; // of curves on any paper, and on white
  const ink = () => getComputedStyle(document.body).color;
  const shown = (box) => box.offsetParent !== null;

  // On a phone: smaller letters, titles of axes in several lines, and room for a legend that needs them, too.
  function narrowed(layout, data, width) {
    layout.font.size = 11;
    const named = data.filter((trace) => trace.name && trace.showlegend !== false);
    const legend = named.length > 1 ? named.reduce((sum, { name }) => sum + 50 + 6 * name.length, 0) : 0;
    const more = 17 * Math.max(Math.ceil(legend / (width - 70)) - 1, 0);
    layout.margin = { ...layout.margin, t: (layout.margin?.t ?? 40) + more };
    layout.height += more;
    const rows = Object.keys(layout).flatMap((key) => (key.startsWith("yaxis") && layout[key].ticktext) || []);
    const beside = 6 * Math.max(4, ...rows.map((label) => label.length)); // px of the names of rows
    for (const name of Object.keys(layout).filter((key) => key.startsWith("xaxis"))) {
      const axis = layout[name];
      axis.tickfont = { size: 10, ...axis.tickfont };
      axis.automargin = true;
      if (axis.type === "log") axis.tickangle = 0;
      if (axis.title?.text) axis.title = { ...axis.title, text: wrapped(axis.title.text, (width - 60 - beside) / 6.5) };
    }
  }
  const wrapped = (text, most) =>
    text.split(" ").reduce((all, word) => (`${all} ${word}`.split("<br>").pop().length > most ? `${all}<br>${word}` : `${all} ${word}`));

  function draw(box) {
    if (box.drawn || !shown(box)) return;
    box.drawn = true;
    const text = box.nextElementSibling.textContent, moving = box.matches(".scene");
    const { data, layout, motion } = JSON.parse(moving ? text : text.replaceAll(GREY, INK));
    if (motion && !Scene.able) {
      box.style.height = "auto";
      box.textContent = "This browser draws nothing in 3-D (WebGL).";
      return;
    }
    layout.font = { ...layout.font, color: moving ? ink() : INK };
    if (box.clientWidth < 600 && !motion) narrowed(layout, data, box.clientWidth);
    box.style.height = `${layout.height}px`;
    // A finger that drags a figure means to scroll the page.
    if (matchMedia("(pointer: coarse)").matches && !motion) layout.dragmode = false;
    Plotly.newPlot(box, data, layout, {
      responsive: true,
      displaylogo: false,
      displayModeBar: (motion || box.clientWidth > 600) && "hover",
      scrollZoom: false, // a wheel over a figure means to scroll the page
      modeBarButtons: motion ? [["zoom3d", "tableRotation", "resetCameraDefault3d"]] : [["zoom2d", "pan2d", "autoScale2d", "resetScale2d"]],
    });
    saving(box);
    if (motion) Scene.draw(box, motion);
    else Scene.follow(box);
  }

  function saving(box) {
    const tools = Object.assign(document.createElement("div"), { className: "save" });
    for (const format of ["SVG", "PNG"]) {
      const title = `Save the figure as ${format}`;
      const button = Object.assign(document.createElement("button"), { type: "button", className: "tool", textContent: format, title, ariaLabel: title });
      button.addEventListener("click", () => save(box, format.toLowerCase()));
      tools.append(button);
    }
    box.parentElement.insertBefore(tools, box.parentElement.querySelector("figcaption"));
  }

  async function save(box, format) {
    const layout = { ...box.layout, paper_bgcolor: "#ffffff", font: { ...box.layout.font, color: INK, family: "sans-serif" } };
    const size = { width: box.clientWidth, height: box.clientHeight };
    const address = await Plotly.toImage({ data: box.data, layout }, { format, ...size, scale: format === "png" ? 2 : 1 });
    const name = `${document.title} figure ${boxes.indexOf(box) + 1}`.replace(/[^\p{L}\p{N}]+/gu, "-");
    Object.assign(document.createElement("a"), { href: address, download: `${name}.${format}` }).click();
  }

  // Of a gallery one view is shown; a choice is passed on to all galleries that offer it.
  const galleries = [...document.querySelectorAll(".gallery")].map((gallery) => {
    const rows = [...gallery.querySelectorAll(":scope > .choices")];
    const views = [...gallery.querySelectorAll(":scope > .view")];
    const places = views.map((view) => view.dataset.at.trim().split(" ").map(Number));
    const at = [...places[0]];
    const show = () => {
      const wanted = places.findIndex((place) => place.every((value, i) => value === at[i]));
      views.forEach((view, i) => (view.hidden = i !== wanted));
      rows.forEach((row, i) =>
        row.querySelectorAll("button").forEach((button, k) => button.setAttribute("aria-pressed", k === at[i])),
      );
      for (const box of views[wanted]?.querySelectorAll(".plot") ?? []) if (box.drawn) Plotly.Plots.resize(box);
    };
    const choose = (label, option) => {
      rows.forEach((row, i) => {
        const k = [...row.querySelectorAll("button")].findIndex((button) => button.textContent === option);
        if (row.getAttribute("aria-label") !== label || k < 0) return;
        const next = [...at];
        next[i] = k;
        if (places.some((place) => place.every((value, j) => value === next[j]))) at[i] = k;
      });
      show();
    };
    for (const row of rows) {
      row.hidden = row.querySelectorAll("button").length < 2;
      row.addEventListener("click", (event) => {
        if (event.target.tagName !== "BUTTON") return;
        const top = row.getBoundingClientRect().top;
        for (const one of galleries) one.choose(row.getAttribute("aria-label"), event.target.textContent);
        if (row.getAttribute("aria-label") === "log") Scene.choose(event.target.textContent);
        scrollBy({ top: row.getBoundingClientRect().top - top, behavior: "instant" });
      });
    }
    gallery.classList.add("chosen");
    show();
    return { choose };
  });

  const near = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: "1000px" },
  );
  plotly.then(() => boxes.forEach((box) => near.observe(box)));

  // The contents show where the reader is.
  const bar = document.querySelector("nav");
  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const here = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        const link = links.get(entry.target.id);
        link.classList.toggle("here", entry.isIntersecting);
        // on a phone the contents are one line
        if (entry.isIntersecting && bar.scrollWidth > bar.clientWidth) bar.scrollTo({ left: link.offsetLeft - 40 });
      }
    },
    { rootMargin: "-20% 0px -75% 0px" },
  );
  document.querySelectorAll("main > section").forEach((part) => here.observe(part));

  const sized = (size, color) => {
    for (const box of boxes.filter((box) => box.drawn && shown(box))) Plotly.relayout(box, box.matches(".scene") ? { ...size, "font.color": color } : size);
  };
  addEventListener("beforeprint", () => {
    if (window.Plotly) boxes.forEach(draw);
    sized({ width: PAPER }, INK);
  });
  addEventListener("afterprint", () => sized({ width: null, autosize: true }, ink()));
})();
