// Figures are drawn when they come near the window, and follow the colour scheme of the page.
(() => {
  const boxes = [...document.querySelectorAll(".plot")];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const ink = () => getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
  const inked = (traces) => traces.flatMap((trace, i) => (trace.meta === "ink" ? [i] : []));

  function draw(box) {
    if (box.drawn) return;
    box.drawn = true;
    const { data, layout } = JSON.parse(box.nextElementSibling.textContent);
    layout.font = { ...layout.font, color: ink() };
    for (const i of inked(data)) {
      data[i].line = { ...data[i].line, color: ink() };
      if (data[i].marker) data[i].marker.color = ink();
    }
    // A finger that drags a figure means to scroll the page.
    if (matchMedia("(pointer: coarse)").matches) layout.dragmode = false;
    Plotly.newPlot(box, data, layout, {
      responsive: true,
      displaylogo: false,
      displayModeBar: box.clientWidth > 600 && "hover",
      modeBarButtons: [["zoom2d", "pan2d", "autoScale2d", "resetScale2d", "toImage"]],
    });
  }

  function paint(color) {
    for (const box of boxes.filter((box) => box.drawn)) {
      Plotly.relayout(box, { "font.color": color });
      const traces = inked(box.data);
      if (traces.length) Plotly.restyle(box, { "line.color": color, "marker.color": color }, traces);
    }
  }

  const near = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: "1000px" },
  );
  boxes.forEach((box) => near.observe(box));
  dark.addEventListener("change", () => paint(ink()));
  addEventListener("beforeprint", () => {
    boxes.forEach(draw);
    paint("#111111");
  });
  addEventListener("afterprint", () => paint(ink()));
})();
