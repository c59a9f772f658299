for (const slider of document.querySelectorAll("input[data-views]")) {
  const views = document.getElementById(slider.dataset.views);
  const show = () => {
    views.style.setProperty("--cut", slider.value + "%");
    slider.setAttribute("aria-valuetext", slider.value + " % reference");
  };
  slider.addEventListener("input", show);
  show();
}
for (const box of document.querySelectorAll("input[data-checkered]")) {
  box.addEventListener("change", () => {
    document.getElementById(box.dataset.checkered).classList.toggle("checkered", box.checked);
  });
}
for (const choice of document.querySelectorAll("input[name=whole]")) {
  choice.addEventListener("change", () => {
    document.getElementById("whole").className = "sheets " + choice.value;
  });
}
window.addEventListener("beforeprint", () => {
  for (const closed of document.querySelectorAll("details")) closed.open = true;
});
