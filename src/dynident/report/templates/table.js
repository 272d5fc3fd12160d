// Tables: sorted by a click on a title, copied as tab-separated text, and never wider than their place: what does not fit
// beside the names follows in a part of its own below, with the names again.
const PAPER = 660; // px of a page of paper, A4 or letter, with its margins
(() => {
  const [WORD, SENTENCE] = [180, 150]; // px to which columns of words and of sentences may be narrowed
  const NAMES = 0.5; // share of the width that names beside every part may take
  const BRIEF = 12; // letters of a cell of words, such as a unit, that stands in one line
  const MISSING = ["", "-"];
  const sum = (all) => all.reduce((a, b) => a + b, 0);

  const inner = (box) => {
    const { paddingLeft, paddingRight } = getComputedStyle(box);
    return box.clientWidth - parseFloat(paddingLeft) - parseFloat(paddingRight);
  };
  const plain = (cell) => {
    if (cell.dataset.value) return cell.dataset.value; // a number with a power of ten
    const copy = cell.cloneNode(true);
    copy.querySelectorAll("math[alttext]").forEach((formula) => formula.replaceWith(formula.getAttribute("alttext")));
    return copy.textContent.trim().replace(/\u2212/g, "-").replace(/\s+/g, " ");
  };

  // By value: what is missing comes last, numbers come before words; digits within words count as numbers.
  const words = new Intl.Collator(undefined, { numeric: true });
  function key(cell) {
    const shown = plain(cell);
    const found = /^[<>≤≥~+]?\s*(-?(?:\d+\.?\d*(?:e[-+]?\d+)?|∞|inf))/i.exec(shown);
    if (!found || !cell.classList.contains("number")) return shown;
    return /∞|inf/i.test(found[1]) ? (found[1][0] === "-" ? -Infinity : Infinity) : Number(found[1]);
  }
  function compared(a, b) {
    if (typeof a === typeof b) return typeof a === "number" ? a - b || 0 : words.compare(a, b);
    return typeof a === "number" ? -1 : 1;
  }

  function copied(value) {
    const old = () => {
      const area = Object.assign(document.createElement("textarea"), { value });
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    };
    return navigator.clipboard ? navigator.clipboard.writeText(value).catch(old) : Promise.resolve(old());
  }

  class Table {
    constructor(place) {
      this.place = place;
      this.table = place.querySelector("table");
      const [titles, groups] = [...this.table.tHead.rows].reverse();
      this.titled = !titles.hidden;
      this.heads = [...titles.cells];
      this.groups = this.heads.map(() => "");
      let k = 0;
      for (const cell of groups?.cells ?? []) for (let i = 0; i < cell.colSpan; i++) this.groups[k++] = plain(cell);
      this.body = this.table.tBodies[0];
      this.rows = [...this.body.rows];
      this.order = this.rows;
      this.cells = this.titled ? this.heads : [...(this.rows[0]?.cells ?? this.heads)]; // which give the columns their widths
      for (const cell of this.body.querySelectorAll(".words")) cell.classList.toggle("brief", cell.textContent.length <= BRIEF);
      this.sorted = { column: -1, down: false };
      this.prose = this.heads.map((head) => head.classList.contains("prose"));
      this.numeric = this.heads.map((head) => head.classList.contains("number"));
      this.bar();
      if (this.titled && this.rows.length > 1) this.sortable();
      place.classList.add("ready");
      place.removeAttribute("tabindex");
      place.addEventListener("click", (event) => {
        const column = event.target.closest?.("button[data-column]")?.dataset.column;
        if (column !== undefined) this.sort(Number(column));
      });
    }

    // Above the table and its parts: its caption, and a button that copies it.
    bar() {
      const bar = Object.assign(document.createElement("div"), { className: "bar" });
      const button = Object.assign(document.createElement("button"), { type: "button", className: "tool", textContent: "Copy" });
      button.title = "Copy the table, to paste it into a spreadsheet";
      button.setAttribute("aria-live", "polite");
      button.addEventListener("click", async () => {
        await copied(this.values());
        button.textContent = "Copied";
        setTimeout(() => (button.textContent = "Copy"), 2000);
      });
      const caption = this.table.caption;
      bar.classList.toggle("bare", !caption);
      if (caption) bar.append(...caption.childNodes, " ");
      caption?.remove();
      bar.append(button);
      this.table.setAttribute("aria-label", this.place.getAttribute("aria-label"));
      this.place.prepend(bar);
    }

    sortable() {
      this.heads.forEach((head, k) => {
        if (!plain(head)) return;
        const button = Object.assign(document.createElement("button"), { type: "button", className: "sort" });
        button.dataset.column = k;
        button.append(...head.childNodes);
        head.append(button);
      });
    }

    // Up, down, then as it was.
    sort(column) {
      const { column: before, down } = this.sorted;
      const back = before === column && down;
      this.sorted = back ? { column: -1, down: false } : { column, down: before === column };
      const kept = this.rows.map((row) => ({ row, key: key(row.cells[column]) }));
      const [missing, found] = [kept.filter((one) => MISSING.includes(one.key)), kept.filter((one) => !MISSING.includes(one.key))];
      const sign = this.sorted.down ? -1 : 1;
      found.sort((a, b) => sign * compared(a.key, b.key));
      this.order = back ? this.rows : [...found, ...missing].map((one) => one.row);
      this.body.append(...this.order);
      this.heads.forEach((head, k) => {
        head.removeAttribute("aria-sort");
        if (k === this.sorted.column) head.setAttribute("aria-sort", this.sorted.down ? "descending" : "ascending");
      });
      this.fit(this.room, true);
      [...this.place.querySelectorAll(`[data-column="${column}"]`)].find((one) => one.offsetParent)?.focus();
    }

    values() {
      const line = (cells) => cells.map((cell) => (/^=/.test(cell) ? `'${cell}` : cell)).join("\t");
      const heads = this.heads.map((head, k) => [this.groups[k], plain(head)].filter(Boolean).join(": "));
      return [...(this.titled ? [line(heads)] : []), ...this.order.map((row) => line([...row.cells].map(plain)))].join("\n");
    }

    // Its columns are measured once, as narrow as their longest words; without a place it is asked again.
    measured() {
      if (this.widths || !this.place.offsetParent) return this.widths;
      this.place.classList.add("least");
      const widths = this.cells.map((cell) => cell.getBoundingClientRect().width);
      this.place.classList.remove("least");
      this.rigid = widths.map((width, k) => this.numeric[k] && width <= WORD); // beside some numbers stands a name
      const named = widths.flatMap((_, k) => (this.numeric[k] && !this.rigid[k] ? [k] : []));
      for (const row of this.rows) for (const k of named) row.cells[k].classList.add("named");
      return (this.widths = widths.map((width, k) => (this.prose[k] ? Math.max(width, SENTENCE) : width)));
    }

    fit(room = inner(this.place.parentElement), anew = false) {
      if (!this.measured() || (room === this.room && !anew)) return;
      this.room = room;
      this.place.querySelectorAll(".part").forEach((part) => part.remove());
      this.least = this.widths.map((width, k) => (this.rigid[k] ? width : Math.min(width, WORD, room / 2)));
      this.cells.forEach((cell, k) => (cell.style.minWidth = `${this.least[k]}px`));
      this.table.hidden = sum(this.least) > room;
      if (this.table.hidden) this.split(room);
    }

    split(room) {
      const wide = (columns) => sum(columns.map((k) => this.least[k]));
      const names = [0];
      const widest = Math.max(...this.least.slice(2));
      if (!this.numeric[1] && this.numeric.includes(true) && wide([0, 1]) < Math.min(NAMES * room, room - widest)) names.push(1);
      const runs = [];
      for (let k = names.length; k < this.least.length; k++) {
        if (this.groups[k] && this.groups[k] === this.groups[runs.at(-1)?.[0]]) runs.at(-1).push(k);
        else runs.push([k]);
      }
      const space = room - wide(names);
      const parts = [];
      let broken = true; // what is wider than a part begins one, and what follows it another
      for (const run of runs) {
        const whole = wide(run) <= space;
        if (broken || !whole || wide([...parts.at(-1), ...run]) > space) parts.push([]);
        broken = !whole;
        for (const piece of whole ? [run] : run.map((k) => [k])) {
          if (parts.at(-1).length && wide([...parts.at(-1), ...piece]) > space) parts.push([]);
          parts.at(-1).push(...piece);
        }
      }
      const label = this.table.getAttribute("aria-label");
      parts.forEach((columns, i) => this.place.append(this.part([...names, ...columns], `${label}, part ${i + 1} of ${parts.length}`)));
    }

    part(columns, label) {
      const part = this.table.cloneNode(false);
      part.hidden = false;
      part.classList.add("part");
      part.setAttribute("aria-label", label);
      const head = part.createTHead();
      if (columns.some((k) => this.groups[k])) head.append(this.over(columns));
      const titles = head.insertRow();
      titles.hidden = !this.titled;
      titles.append(...columns.map((k) => this.heads[k].cloneNode(true)));
      const body = part.createTBody();
      for (const row of this.order) body.insertRow().append(...columns.map((k) => row.cells[k].cloneNode(true)));
      return part;
    }

    over(columns) {
      const row = Object.assign(document.createElement("tr"), { className: "groups" });
      columns.forEach((k, i) => {
        const name = this.groups[k];
        if (i && name === this.groups[columns[i - 1]]) return void row.lastChild.colSpan++;
        const cell = document.createElement(name ? "th" : "td");
        cell.textContent = name;
        if (name) cell.scope = "colgroup";
        row.append(cell);
      });
      return row;
    }
  }

  const tables = [...document.querySelectorAll(".scroll")].map((place) => new Table(place));
  let printing = false;
  const fit = () => printing || tables.forEach((one) => one.fit());
  const resized = new ResizeObserver(fit);
  for (const parent of new Set(tables.map((one) => one.place.parentElement))) resized.observe(parent);

  addEventListener("beforeprint", () => {
    printing = true;
    const main = document.querySelector("main").clientWidth;
    tables.forEach((one) => one.fit(PAPER - main + inner(one.place.parentElement), true));
  });
  addEventListener("afterprint", () => {
    printing = false;
    fit();
  });
})();
