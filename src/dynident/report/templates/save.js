// Figures are saved as SVG and PNG, as they are shown, in ink on white paper whatever the scheme of the page.
const saving = (() => {
  const INK = "#111111";

  // A name for a file: the page, the figure's place in it, what the choices above it show.
  function named(box) {
    const place = [...document.querySelectorAll(".plot")].indexOf(box) + 1;
    return `${document.title} figure ${place}`.replace(/[^\p{L}\p{N}]+/gu, "-");
  }

  async function save(box, format, traces) {
    const data = traces().map((trace) => (trace.meta === "ink" ? inked(trace) : trace));
    const layout = { ...box.layout, paper_bgcolor: "#ffffff", font: { ...box.layout.font, color: INK, family: "sans-serif" } };
    const size = { width: box.clientWidth, height: box.clientHeight };
    const address = await Plotly.toImage({ data, layout }, { format, ...size, scale: format === "png" ? 2 : 1 });
    Object.assign(document.createElement("a"), { href: address, download: `${named(box)}.${format}` }).click();
  }

  const inked = (trace) => ({
    ...trace,
    line: { ...trace.line, color: INK },
    ...(trace.marker && { marker: { ...trace.marker, color: INK } }),
  });

  return (box, traces) => {
    const tools = Object.assign(document.createElement("div"), { className: "save" });
    for (const format of ["svg", "png"]) {
      const button = Object.assign(document.createElement("button"), { type: "button", className: "tool", textContent: format.toUpperCase() });
      button.setAttribute("aria-label", `Save the figure as ${button.textContent}`);
      button.title = button.getAttribute("aria-label");
      button.addEventListener("click", () => save(box, format, traces));
      tools.append(button);
    }
    box.parentElement.insertBefore(tools, box.parentElement.querySelector("figcaption"));
  };
})();
