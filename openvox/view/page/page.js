// Tables that are sorted and searched, and what ties them to the scenes.

const data = JSON.parse(document.getElementById("data").textContent);
const rows = [...document.querySelectorAll("tr[data-select]")];
const status = document.getElementById("status");
const scenes = [];

/** The ids that a row stands for, one list a scene. */
function idsOf(row) {
  return JSON.parse(row.dataset.select);
}

function choose(row, { scroll } = {}) {
  const again = row?.getAttribute("aria-selected") === "true" && !scroll;
  const chosen = again ? null : row;
  for (const other of rows) other.setAttribute("aria-selected", String(other === chosen));
  const ids = chosen ? idsOf(chosen) : [];
  scenes.forEach((scene, k) => {
    scene.set({ selected: new Set((ids[k] ?? []).map((id) => scene.map.ids.indexOf(id) + 1)) });
  });
  if (status) status.textContent = chosen ? chosen.dataset.name : "";
  if (chosen && scroll) {
    chosen.hidden = false;
    chosen.scrollIntoView({ block: "nearest" });
  }
}

for (const row of rows) {
  row.addEventListener("click", (event) => {
    if (!event.target.closest("a, summary")) choose(row);
  });
}

for (const link of document.querySelectorAll("a[href^='#instance-']")) {
  link.addEventListener("click", () => choose(document.querySelector(link.hash), { scroll: true }));
}

for (const table of document.querySelectorAll("table.sorted")) {
  const body = table.tBodies[0];
  const buttons = [...table.tHead.querySelectorAll("button")];
  const order = (button, down) => {
    const column = button.closest("th");
    const at = [...column.parentElement.children].indexOf(column);
    const value = (row) => row.children[at].dataset.value ?? row.children[at].textContent.trim();
    const numbers = column.dataset.kind === "number";
    const sorted = [...body.rows].sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      return (numbers ? Number(x) - Number(y) : x.localeCompare(y)) * (down ? -1 : 1);
    });
    body.append(...sorted);
    for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
    column.setAttribute("aria-sort", down ? "descending" : "ascending");
  };
  for (const button of buttons) {
    button.addEventListener("click", () => {
      const column = button.closest("th");
      const before = column.getAttribute("aria-sort");
      order(button, before ? before === "ascending" : column.dataset.first === "down");
    });
  }
}

for (const search of document.querySelectorAll("input[type=search]")) {
  const body = document.getElementById(search.dataset.table).tBodies[0];
  const count = document.getElementById(search.dataset.count);
  const look = () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    let found = 0;
    for (const row of body.rows) {
      row.hidden = !words.every((word) => (row.dataset.text ?? row.textContent.toLowerCase()).includes(word));
      found += !row.hidden;
    }
    count.textContent = words.length ? `${found} of ${body.rows.length}` : `${body.rows.length}`;
  };
  search.addEventListener("input", look);
  look();
}

function openScenes() {
  const corners = (pick, of) => [0, 1, 2].map((a) => pick(...data.maps.map((map) => map[of][a])));
  const view = new View(corners(Math.min, "lowest"), corners(Math.max, "highest"));
  view.first = data.azimuth;
  view.home();
  data.maps.forEach((map, k) => {
    const canvas = document.getElementById(`scene-${k}`);
    const picked = (place) => {
      const id = map.ids[place - 1];
      choose(rows.find((row) => idsOf(row)[k]?.includes(id)) ?? null, { scroll: true });
    };
    scenes.push(new Scene(canvas, map, view, picked));
  });
  for (const choice of document.querySelectorAll("select[data-set]")) {
    const apply = () => {
      const value = choice.dataset.set === "walls" ? Number(choice.value) : choice.value;
      scenes.forEach((scene) => scene.set({ [choice.dataset.set]: value }));
      if (choice.dataset.set === "mode") document.getElementById("scenes").dataset.mode = choice.value;
    };
    choice.addEventListener("change", apply);
    apply();
  }
  const doing = {
    home: () => view.home(),
    closer: () => { view.zoom *= 1.3; view.changed(); },
    further: () => { view.zoom /= 1.3; view.changed(); },
    above: () => { view.home(); view.elevation = 1.55; view.changed(); },
  };
  for (const button of document.querySelectorAll("button[data-do]")) button.addEventListener("click", doing[button.dataset.do]);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => scenes.forEach((scene) => scene.set({})));
}

if (data.maps?.length) {
  const box = document.getElementById("scenes");
  try {
    openScenes();
    box.dataset.state = "drawn";
  } catch (error) {
    scenes.length = 0;
    box.dataset.state = "missing";
    document.getElementById("no-scene").hidden = false;
  }
}
