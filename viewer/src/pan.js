// SPDX-License-Identifier: Apache-2.0
// A picture that is moved by dragging and enlarged by the wheel, two fingers or the keyboard.
const MOST = 16;
const STEP_PX = 60;

export function makePannable(holder) {
  const image = holder.querySelector("img");
  const view = { x: 0, y: 0, scale: 1 };
  const pointers = new Map();

  const show = () => {
    view.scale = Math.min(Math.max(view.scale, 1), MOST);
    const most = { x: holder.clientWidth * (view.scale - 1), y: image.clientHeight * view.scale - holder.clientHeight };
    view.x = Math.min(0, Math.max(view.x, -most.x));
    view.y = Math.min(0, Math.max(view.y, -Math.max(most.y, 0)));
    image.style.transform = `translate(${view.x}px, ${view.y}px) scale(${view.scale})`;
    holder.style.touchAction = view.scale > 1 ? "none" : "pan-y";
  };
  const zoom = (factor, x, y) => {
    const scale = Math.min(Math.max(view.scale * factor, 1), MOST);
    view.x = x - ((x - view.x) * scale) / view.scale;
    view.y = y - ((y - view.y) * scale) / view.scale;
    view.scale = scale;
    show();
  };

  holder.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && view.scale === 1 && event.deltaY > 0) return; // the page scrolls on
    event.preventDefault();
    const box = holder.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY / 400), event.clientX - box.left, event.clientY - box.top);
  }, { passive: false });
  holder.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, event);
    holder.setPointerCapture(event.pointerId);
  });
  holder.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const box = holder.getBoundingClientRect();
    const other = [...pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
    if (other) {
      const apart = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY) || 1;
      zoom(apart(event) / apart(before), other.clientX - box.left, other.clientY - box.top);
    } else {
      view.x += event.clientX - before.clientX;
      view.y += event.clientY - before.clientY;
      show();
    }
    pointers.set(event.pointerId, event);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    holder.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  holder.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const factor = { "+": 1.4, "=": 1.4, "-": 1 / 1.4 }[event.key];
    if (factor) zoom(factor, holder.clientWidth / 2, holder.clientHeight / 2);
    else if (moves[event.key] && view.scale > 1) {
      view.x += STEP_PX * moves[event.key][0];
      view.y += STEP_PX * moves[event.key][1];
      show();
    } else return;
    event.preventDefault();
  });
  holder.addEventListener("dblclick", () => {
    Object.assign(view, { x: 0, y: 0, scale: 1 });
    show();
  });
}
